"""A printed partition probe: a folder of files that agree with one another."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from skylight.errors import InputError
from skylight.probes.fabrication._mount import Pole
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._printing_files import (
    free_discs,
    summarise_partition_print,
    write_printed_partitions,
)
from skylight.probes.partitions.printed import _printing
from skylight.probes.partitions.printed._assembly import load_partition_assembly
from skylight.probes.partitions.printed._printing import PrintedPartitions, print_partition_probe
from skylight.probes.partitions.printed._solids import ProbeSizes


@pytest.fixture(scope="module")
def cube() -> PrintedPartitions:
    return print_partition_probe(named_design("6d"), ProbeSizes(outer_mm=60.0, kernel_mm=9.0))


@pytest.fixture(scope="module")
def folder(cube: PrintedPartitions, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("probe")
    write_printed_partitions(folder, cube, panel_px=120)
    return folder


def test_files(folder: Path) -> None:
    names = {file.name for file in folder.iterdir()}
    parts = {f"{part}.stl" for part in ("shell_lower", "shell_upper", "kernel", "parts")}
    others = {"parts.3mf", "marker_base.stl", "marker_base.3mf"}
    assert names == parts | others | {"assembly.png", "assembly.json", "report.json"}


def test_parts_lie_on_the_bed(folder: Path) -> None:
    for name in ("shell_lower", "shell_upper", "kernel"):
        mesh = trimesh.load_mesh(folder / f"{name}.stl")
        assert mesh.is_watertight
        assert mesh.body_count == 1
        np.testing.assert_allclose(mesh.bounds[0], 0, atol=1e-5)
    # the kernel lies on a face
    assert mesh.extents[2] == pytest.approx(18, abs=1e-4)


def test_report(folder: Path) -> None:
    report = json.loads((folder / "report.json").read_text())
    assert report["sound"] is True
    assert [part["name"] for part in report["parts"]] == [
        "shell_lower",
        "kernel",
        "shell_upper",
        "marker_base",
    ]
    assert {file["name"] for file in report["files"]} == {p.name for p in folder.glob("*.stl")}
    assert all(file["watertight"] for file in report["files"])
    lower = next(file for file in report["files"] if file["name"] == "shell_lower.stl")
    assert lower["volume_mm3"] == pytest.approx(report["parts"][0]["volume_mm3"], rel=1e-5)
    assert max(report["loss"]) < 0.01
    assert report["parts_mm3"]["kernel"] == pytest.approx(18**3)


def test_assembly_is_what_was_measured(folder: Path, cube: PrintedPartitions) -> None:
    standing = load_partition_assembly(folder / "assembly.json")
    assert (standing.response == cube.visibility.response).all()
    # the pole's 120 mm end 30 mm below the centre and 1.8 mm below the board
    height = 120 - 1.8
    assert standing.pole_mm == pytest.approx((87.5, 62.5, 3.0, height), abs=0.5)
    assert float(standing.board_from_probe.translation[1]) == pytest.approx(height + 30)
    np.testing.assert_allclose(standing.board_from_probe.translation[[0, 2]], [87.5, 62.5])


def test_picture(folder: Path) -> None:
    picture = np.array(Image.open(folder / "assembly.png").convert("RGB")).astype(int)
    assert (picture.max(2) - picture.min(2) > 40).mean() > 0.02  # coloured cells
    assert (picture.max(2) < 130).mean() > 0.01  # dark shells


def test_summary(cube: PrintedPartitions) -> None:
    said = summarise_partition_print(cube)
    assert "two half shells with 4 pins" in said
    assert "walls 1.60 mm or more" in said
    across = 2 * cube.face_radii_mm[0]
    assert f"discs of {across:.1f} mm across are free" in said


def test_discs_of_several_sizes() -> None:
    assert free_discs(np.array([4.0, 4.85])) == "8.0 to 9.7 mm"


def test_poles_that_let_the_shell_hide_the_board_are_told(cube: PrintedPartitions) -> None:
    """Seen 60 degrees from above, its shadow on the board begins at c / tan 60 - r / sin 60."""
    assert "make it 122 mm or longer" in cube.warnings[0]
    assert not replace(cube, pole=Pole(length_mm=190.0)).warnings
    wide = replace(cube, sizes=ProbeSizes(outer_mm=80.0), pole=Pole(length_mm=161.8))
    assert not wide.warnings
    slope = np.radians(60)
    centre = 2.5 * 80.0
    hidden_from = centre / np.tan(slope) - 40 / np.sin(slope)
    assert hidden_from >= wide.board.height_mm / 2


def test_short_poles_are_refused_before_parts_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_printing, "probe_parts", None)
    with pytest.raises(InputError, match="122 mm"):
        print_partition_probe(
            named_design("6d"), ProbeSizes(outer_mm=60.0, kernel_mm=9.0), pole=Pole(length_mm=20.0)
        )
