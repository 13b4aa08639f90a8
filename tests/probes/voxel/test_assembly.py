"""Where a probe stands: files, the pole, and what they refuse."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.io._bounded import write_json
from skylight.probes.voxel._model import star_probe
from skylight.probes.voxel._parts import PlacedProbe, VoxelAssembly, load_voxel_assembly
from skylight.sphere._rotation import RigidTransform

QUARTER = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])


def standing() -> VoxelAssembly:
    return VoxelAssembly(
        model=star_probe(3),
        voxel_mm=20.0,
        board_from_probe=RigidTransform.from_numpy(QUARTER, np.array([50.0, 80.0, 70.0])),
        pole_mm=(80.0, 40.0, 4.0, 80.0),
    )


def test_files_keep_everything(tmp_path: Path) -> None:
    path = tmp_path / "assembly.json"
    write_json(path, standing().to_json())
    again = load_voxel_assembly(path)
    assert (again.model.occupied == star_probe(3).occupied).all()
    assert (again.board_from_probe.rotation.numpy() == QUARTER).all()
    assert again.board_from_probe.translation.tolist() == [50.0, 80.0, 70.0]
    assert again.voxel_mm == 20
    assert again.pole_mm == (80.0, 40.0, 4.0, 80.0)


def test_cells_in_millimetres_of_the_board() -> None:
    point = np.array([3.0, 1.0, 2.0])
    np.testing.assert_allclose(standing().to_board(point), QUARTER @ (20 * point) + [50, 80, 70])


def test_the_pole_hides_the_tip_below() -> None:
    """Seen from below, the middle of the downward tip is behind the pole, its corners are not."""
    probe = PlacedProbe(standing())
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
    write_json(path, standing().to_json())
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=message):
        load_voxel_assembly(path)
