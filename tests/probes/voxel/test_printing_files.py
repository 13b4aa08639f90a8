"""`skylight probe voxel print`: a folder of files that agree with one another."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from skylight.cli import main
from skylight.probes.fabrication._parts import PrintSizes
from skylight.probes.voxel import _printing_files as probe_printing
from skylight.probes.voxel._assembly import load_voxel_assembly
from skylight.probes.voxel._model import VoxelModel, exposed_faces, star_probe, write_voxels
from skylight.probes.voxel._printing import PrintedProbe, print_voxel_probe
from skylight.probes.voxel._printing_files import (
    describe_assembly,
    summarise_print,
    write_printed_probe,
)


@pytest.fixture(scope="module")
def cross() -> PrintedProbe:
    return print_voxel_probe(star_probe(3), PrintSizes(), title="3-probe")


@pytest.fixture(scope="module")
def folder(cross: PrintedProbe, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("probe")
    write_printed_probe(folder, cross, panel_px=120)
    return folder


def test_files(folder: Path) -> None:
    names = {file.name for file in folder.iterdir()}
    parts = {f"part_0{i}.stl" for i in range(1, 8)}
    others = {"parts.stl", "parts.3mf", "foot.stl", "marker_base.stl", "marker_base.3mf"}
    assert names == parts | others | {"assembly.png", "assembly.json", "report.json"}


def test_parts_together_are_the_parts_alone(folder: Path) -> None:
    alone = [trimesh.load_mesh(f) for f in sorted(folder.glob("part_*.stl"))]
    alone.append(trimesh.load_mesh(folder / "foot.stl"))
    together = trimesh.load_mesh(folder / "parts.stl")
    assert together.volume == pytest.approx(sum(mesh.volume for mesh in alone), rel=1e-5)
    assert together.body_count == 8
    for mesh in alone:
        assert mesh.is_watertight
        np.testing.assert_allclose(mesh.bounds[0], 0, atol=1e-5)


def test_report(folder: Path) -> None:
    report = json.loads((folder / "report.json").read_text())
    assert report["sound"] is True
    assert report["problems"] == []
    assert report["material_saved"] == pytest.approx(1 - report["parts_mm3"] / (7 * 20**3))
    assert [part["name"] for part in report["parts"]][-1] == "marker_base"


def test_picture(folder: Path) -> None:
    picture = np.array(Image.open(folder / "assembly.png").convert("RGB")).astype(int)
    assert (picture.max(2) - picture.min(2) > 40).mean() > 0.02  # coloured parts


def test_assembly_places_the_probe_on_the_board(folder: Path) -> None:
    """A corner of a face in the board's frame, by hand."""
    content = json.loads((folder / "assembly.json").read_text())
    standing = load_voxel_assembly(folder / "assembly.json")
    board = standing.to_board(exposed_faces(star_probe(3)).corners.numpy())
    # the pole's 120 mm end 10 mm above the lowest face and 1.8 mm below the board
    height = 120 - 10 - 1.8
    assert board[..., 1].min() == pytest.approx(height)
    assert board[..., 1].max() == pytest.approx(height + 60)
    np.testing.assert_allclose(board[..., 0].mean(), 87.5)
    np.testing.assert_allclose(board[..., 2].mean(), 62.5)
    np.testing.assert_allclose(content["probe_centre_mm"], [87.5, height + 30, 62.5])
    assert [step["onto"] for step in content["steps"]][:2] == ["foot", "part_01"]
    # upright: its axes are the board's
    np.testing.assert_array_equal(standing.board_from_probe.rotation, np.eye(3))
    assert standing.pole_mm == pytest.approx((87.5, 62.5, 3.0, height))
    assert (standing.model.occupied == star_probe(3).occupied).all()


def test_the_pole_hides_the_only_face_of_its_kind(cross: PrintedProbe) -> None:
    hidden = describe_assembly(cross)["hidden_face"]
    assert isinstance(hidden, dict)
    assert hidden["voxel"] == [1, 0, 1]
    assert hidden["orientation"] == "-y"
    assert hidden["configuration"] == 0
    assert hidden["slot_lost"] is True
    assert "which no other face has" in summarise_print(cross)


def test_a_plate_has_more_faces_below() -> None:
    plate = VoxelModel(occupied=np.ones((3, 1, 1), bool))
    hidden = describe_assembly(print_voxel_probe(plate, PrintSizes(), title="plate"))["hidden_face"]
    assert isinstance(hidden, dict)
    assert hidden["other_faces_of_this_slot"] == 2
    assert hidden["slot_lost"] is False


class TestCommand:
    @pytest.fixture(autouse=True)
    def no_picture(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(probe_printing, "write_print_picture", lambda *_, **__: None)

    def test_sizes_are_those_asked_for(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        write_voxels(tmp_path / "a.npy", VoxelModel(occupied=np.ones((2, 1, 1), bool)))
        sizes = ["--face-mm", "15", "--wall-mm", "1.2", "--clearance-mm", "0.2"]
        out = tmp_path / "out"
        out.mkdir()
        for name in ("part_03.stl", "part_2_of_mine.stl"):  # of a larger model, and the user's
            (out / name).touch()
        arguments = ["--voxels", str(tmp_path / "a.npy"), *sizes, "--out", str(out)]
        assert main(["probe", "voxel", "print", *arguments]) == 0
        left = sorted(path.name for path in out.glob("part_*"))
        assert left == ["part_01.stl", "part_02.stl", "part_2_of_mine.stl"]
        report = json.loads((out / "report.json").read_text())
        assert report["sizes"] == {"face_mm": 15, "wall_mm": 1.2, "clearance_mm": 0.2}
        assert report["thinnest_wall_mm"] == pytest.approx(1.2, abs=1e-6)
        captured = capsys.readouterr()
        assert captured.err == ""
        assert "2 and a foot" in captured.out

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ([], "--probe"),
            (["--probe", "4"], "odd number"),
            (["--probe", "3", "--wall-mm", "4"], "no room for a joint"),
            (["--probe", "3", "--clearance-mm", "2"], "must be below wall_mm"),
            (["--probe", "3", "--pole-mm", "19"], "does not fit"),
            (["--voxels", "missing.npy"], "cannot be read"),
        ],
    )
    def test_one_line_on_failure(
        self,
        arguments: list[str],
        message: str,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        out = tmp_path / "out"
        assert main(["probe", "voxel", "print", *arguments, "--out", str(out)]) == 2
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1
        assert message in lines[0]
        assert not out.exists()
