"""Where a probe stands: its file, its edges over the board, the pole, and what they refuse."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.io._bounded import write_json
from skylight.probes.voxel._assembly import PlacedProbe, VoxelAssembly, load_voxel_assembly
from skylight.probes.voxel._captured import Alignment, edges_of, visible_edges
from skylight.probes.voxel._model import VoxelModel, star_probe
from skylight.sphere._rotation import RigidTransform

QUARTER = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
STANDING = VoxelAssembly(
    model=star_probe(3),
    voxel_mm=20.0,
    board_from_probe=RigidTransform.from_numpy(QUARTER, np.array([50.0, 80.0, 70.0])),
    pole_mm=(80.0, 40.0, 4.0, 80.0),
)


def placed(model: VoxelModel, voxel_mm: float = 10.0) -> PlacedProbe:
    shift = torch.tensor([5.0, 0, 0], dtype=torch.float64)
    return PlacedProbe(
        VoxelAssembly(
            model=model,
            voxel_mm=voxel_mm,
            board_from_probe=RigidTransform.translating(shift),
        )
    )


def test_files_keep_everything(tmp_path: Path) -> None:
    path = tmp_path / "assembly.json"
    write_json(path, STANDING.to_json())
    again = load_voxel_assembly(path)
    assert (again.model.occupied == star_probe(3).occupied).all()
    assert (again.board_from_probe.rotation.numpy() == QUARTER).all()
    assert again.board_from_probe.translation.tolist() == [50.0, 80.0, 70.0]
    assert again.voxel_mm == 20
    assert again.pole_mm == (80.0, 40.0, 4.0, 80.0)
    point = np.array([3.0, 1.0, 2.0])
    np.testing.assert_allclose(again.to_board(point), QUARTER @ (20 * point) + [50, 80, 70])


def test_the_pole_hides_the_tip_below() -> None:
    """Seen from below, the middle of the downward tip is behind the pole, its corners are not."""
    probe = PlacedProbe(STANDING)
    down = (probe.faces.orientation == 3) & (probe.faces.configuration == 0)
    (face,) = torch.nonzero(down)[:, 0].tolist()
    middle = probe.corners[face].mean(0)
    eye = middle + np.array([200.0, -60.0, 0.0])
    points = np.concatenate(
        [middle[None], probe.corners[face] + 0.02 * (middle - probe.corners[face])]
    )
    seen = probe.sees(eye, points).tolist()
    assert seen[0] == 0
    assert 1 in seen[1:]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": 2}, "format 2"),
        ({"cells": []}, "cells"),
        ({"cells": [[0, 0, 99]]}, "cells"),
        ({"cells": [[0, 0, 1e38]]}, "cells"),
        ({"cells": [[0, 0, 0.5]]}, "cells"),
        ({"cells": [["0", "1", "2"]]}, "cells"),
        ({"rotation": [1, 2]}, "not those"),
        ({"rotation": (2 * np.eye(3)).tolist()}, "orthonormal"),
        ({"pole_mm": ["inf", 0, 1, 1]}, "not those"),
        ({"pole_mm": [0, 0, -3, 50]}, "above 0"),
        ({"board_mm": [0, 50]}, "above 0"),
        ({"voxel_mm": -1}, "above 0 mm"),
        ({"voxel_mm": "wide"}, "not those"),
    ],
)
def test_files_that_are_no_probes_are_refused(
    tmp_path: Path, change: dict[str, object], message: str
) -> None:
    path = tmp_path / "assembly.json"
    path.write_text(json.dumps(STANDING.to_json() | change))
    with pytest.raises(InputError, match=message):
        load_voxel_assembly(path)


@pytest.mark.parametrize(("size", "count"), [(1, 12), (3, 6 * 8 + 12)])
def test_edges_lie_between_faces_of_different_orientation(size: int, count: int) -> None:
    """A cube has 12. Each of the cross' arms has 4 round its tip, 4 along it, and 12 are inner."""
    ends, outward = edges_of(placed(star_probe(size)))
    assert len(ends) == len(outward) == count
    np.testing.assert_allclose(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), 10)
    across = np.einsum("nc,nc->n", ends[:, 1] - ends[:, 0], outward)
    np.testing.assert_allclose(across, 0, atol=1e-9)


def test_faces_in_one_plane_have_no_edge_between_them() -> None:
    bar = VoxelModel(occupied=np.ones((3, 1, 1), bool))
    ends, _ = edges_of(placed(bar))
    # the long edges in three pieces each, and four round each end
    assert len(ends) == 4 * 3 + 8


def test_a_cube_shows_nine_of_its_edges_from_a_corner() -> None:
    cube = placed(star_probe(1))
    ends, outward = edges_of(cube)
    seen = visible_edges(cube, np.array([90.0, 100.0, 110.0]), ends, outward)
    assert seen.sum() == 9
    # the three that meet in the corner opposite
    far = np.array([5.0, 0, 0])
    hidden = (np.abs(ends - far).max(2) < 1e-9).any(1)
    assert (seen == ~hidden).all()


def test_an_alignment_turns_about_the_middle_and_shifts() -> None:
    probe = placed(star_probe(3))
    middle = probe.assembly.to_board(np.full(3, 1.5))
    one = Alignment(
        centre_mm=middle,
        turn_deg=np.array([0.0, 90.0, 0.0]),
        shift_mm=np.array([1.0, 2.0, 3.0]),
        turn_spread_deg=0.1,
        shift_spread_mm=0.1,
        pictures=5,
    )
    assert one.agrees
    moved = one.applied(probe.assembly)
    np.testing.assert_allclose(moved.to_board(np.full(3, 1.5)), middle + np.array([1, 2, 3]))
    # +X becomes -Z
    tip = moved.to_board(np.array([2.5, 1.5, 1.5])) - moved.to_board(np.full(3, 1.5))
    np.testing.assert_allclose(tip, [0, 0, -10], atol=1e-9)
