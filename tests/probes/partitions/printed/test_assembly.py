"""Where a probe stands: files there and back, what is seen, and what is refused."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.io._bounded import write_json
from skylight.probes.partitions._captured import FaceDiscs
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions.printed._assembly import (
    PartitionAssembly,
    PlacedPartitions,
    load_partition_assembly,
)
from skylight.probes.partitions.printed._halves import standing_rotation
from skylight.probes.partitions.printed._solids import ProbeSizes
from skylight.sphere._rotation import RigidTransform


def standing() -> PartitionAssembly:
    cells = Cells.of(named_design("6d"))
    return PartitionAssembly(
        cells=cells,
        sizes=ProbeSizes(outer_mm=60.0, kernel_mm=9.0),
        board_from_probe=RigidTransform.from_numpy(
            standing_rotation(cells), np.array([87.5, 148.0, 62.5])
        ),
        pole_mm=(87.5, 62.5, 3.0, 118.0),
        board_mm=(175.0, 125.0),
        response=torch.diag(torch.linspace(1.0, 1.5, 6).double()),
    )


@pytest.fixture(scope="module")
def placed() -> PlacedPartitions:
    return standing().placed()


def test_files_keep_everything(tmp_path: Path) -> None:
    path = tmp_path / "assembly.json"
    probe = standing()
    write_json(path, probe.to_json())
    again = load_partition_assembly(path)
    torch.testing.assert_close(again.design.seeds, probe.design.seeds, atol=0, rtol=0)
    assert again.design.labels.tolist() == probe.design.labels.tolist()
    assert again.sizes == probe.sizes
    assert (again.board_from_probe.matrix() == probe.board_from_probe.matrix()).all()
    assert (again.pole_mm, again.board_mm) == (probe.pole_mm, probe.board_mm)
    assert (again.response == probe.response).all()


def test_faces_stand_about_the_centre(placed: PlacedPartitions) -> None:
    away = placed.face_centres - np.array([87.5, 148.0, 62.5])
    np.testing.assert_allclose(away, 9 * placed.normals)
    # on its corner: three faces look up and three down, all at the same angle
    np.testing.assert_allclose(np.sort(placed.normals[:, 1]), [-(3**-0.5)] * 3 + [3**-0.5] * 3)
    np.testing.assert_allclose(placed.vertices[:, 1].min(), 0, atol=1e-9)  # the pole's end


def test_faces_are_seen_from_their_cells_alone(placed: PlacedPartitions) -> None:
    for centre, normal in zip(placed.face_centres, placed.normals, strict=True):
        seen = placed.sees(centre + 400 * normal, placed.face_centres)
        assert seen.argmax() == np.flatnonzero((placed.normals == normal).all(1))[0]
        assert seen.sum() == 1


def test_three_faces_are_seen_over_a_junction(placed: PlacedPartitions) -> None:
    """From straight above, as in the thesis' Fig. 4.6; the pole hides none of them."""
    eye = np.array([87.5, 600.0, 62.5])
    assert placed.sees(eye, placed.face_centres).sum() == 3


def test_other_boards_are_refused() -> None:
    standing().require_board((175.0, 125.0))
    with pytest.raises(InputError, match="175 x 125"):
        standing().require_board((100.0, 125.0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "voxel probe assembly"}, "kind"),
        ({"format": 2}, "format 2"),
        ({"rotation": (2 * np.eye(3)).tolist()}, "orthonormal"),
        ({"rotation": [1, 2]}, "not those"),
        ({"response": [[1.0]]}, "6 x 6"),
        ({"sizes": {"outer_mm": -1.0}}, "outer_mm"),
        ({"sizes": {"height_mm": 1.0}}, "not those"),
        ({"pole_mm": None}, "not those"),
        ({"design": {"name": "a"}}, "not those"),
        ({"design": 3}, "not those"),
    ],
)
def test_files_that_are_no_probes_are_refused(tmp_path, change, message):
    path = tmp_path / "assembly.json"
    write_json(path, standing().to_json())
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=message):
        load_partition_assembly(path)


def test_oriented_probes_are_not_turned() -> None:
    cells = Cells.of(named_design("14d-outdoor"))
    with pytest.raises(InputError, match="turned"):
        PartitionAssembly(
            cells=cells,
            sizes=ProbeSizes(outer_mm=60.0, kernel_mm=9.0),
            board_from_probe=standing().board_from_probe,
            pole_mm=(0.0, 0.0, 3.0, 1.0),
            board_mm=(175.0, 125.0),
            response=torch.eye(14).double(),
        )


def test_flared_rims_leave_three_whole_discs_over_a_junction() -> None:
    """To cameras ten radii of the shell away and farther; nearer ones see less than the discs."""
    probe = replace(standing(), sizes=ProbeSizes(kernel_mm=4.0, flare=1.0))
    discs = FaceDiscs(probe.placed())
    above = np.array([0.0, 1.0, 0.0])  # the cube stands on its corner, and the pole is below
    middle = probe.board_from_probe.translation.numpy()
    for radii, whole in ((10.5, 3), (15.0, 3), (200.0, 3), (2.0, 0)):
        eye = middle + radii * 40 * above
        seen = discs.probe.sees(eye, discs.guard).numpy().all(1)
        assert seen.sum() == whole


def test_files_without_a_flare_are_of_plain_walls(tmp_path: Path) -> None:
    """Those of probes that were printed before there was any."""
    path = tmp_path / "assembly.json"
    told = standing().to_json()
    sizes = dict(asdict(standing().sizes))
    assert sizes.pop("flare") == 0
    write_json(path, told | {"sizes": sizes})
    assert load_partition_assembly(path).sizes == standing().sizes
