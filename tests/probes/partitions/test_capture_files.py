"""A partition probe's capture by the command line, on drawn pictures; and its other first verbs."""

import io
import json
import re
import sys
from contextlib import redirect_stdout
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from skylight.cli import main
from skylight.errors import InputError
from skylight.io._bounded import write_json
from skylight.probes.cameras._alignment import OutlineAligner
from skylight.probes.cameras._board import Board, save_board
from skylight.probes.cameras._intrinsics import Intrinsics, save_intrinsics
from skylight.probes.cameras._response import Response, save_response
from skylight.probes.partitions._capture_files import (
    PartitionAligner,
    completed_shading,
    outline_of,
    symmetry,
)
from skylight.probes.partitions._captured import load_capture
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._design_files import write_cells
from skylight.probes.partitions._kernel_albedo import (
    KernelAlbedo,
    measure_albedo,
    read_albedo,
    save_albedo,
)
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions._seeds import load_design
from skylight.probes.partitions.printed._assembly import (
    PartitionAssembly,
    PlacedPartitions,
    load_partition_assembly,
    placed_parts,
)
from skylight.probes.partitions.printed._halves import probe_parts, standing_rotation
from skylight.probes.partitions.printed._printing import measure_visibility
from skylight.probes.partitions.printed._solids import ProbeSizes, WallNet
from skylight.sphere._rotation import RigidTransform
from tests.probes.partitions.pictures import board_seen, looking_from, picture_of_faces
from tests.probes.partitions.test_kernel_albedo import (
    GAMMA,
    MATERIAL,
    PATCH,
    photo as photo_of_chart,
)

BOARD = Board(columns=7, rows=5, square_mm=30.0, marker_mm=22.0)
LENS = Intrinsics(width=640, height=480, fx=560.0, fy=560.0, cx=322.0, cy=238.0, k1=-0.08)
MIDDLE, POLE = np.array([105.0, 150.0, 75.0]), (105.0, 75.0, 3.0, 120.0)
SIZES = ProbeSizes(outer_mm=60.0, kernel_mm=9.0)
CELLS = Cells.of(named_design("6d"))
TURN = standing_rotation(CELLS)
SHINE = np.random.default_rng(8).uniform(0.05, 0.7, (6, 3))
# one corner of the cube is up; this is another, and then the one across
CORNER = TURN @ np.array([1.0, 1.0, -1.0])


@cache
def probe() -> PlacedPartitions:
    return placed_parts(probe_parts(CELLS, SIZES, rotation=TURN, pole_mm=6.0), SIZES, MIDDLE, POLE)


@cache
def standing() -> PartitionAssembly:
    placed = probe()
    seen = measure_visibility(
        CELLS,
        placed.caster,
        centres=placed.face_centres,
        radii=placed.face_radii,
        rotation=TURN,
        directions=4000,
    )
    return PartitionAssembly(
        cells=CELLS,
        sizes=SIZES,
        board_from_probe=RigidTransform.from_numpy(TURN, MIDDLE),
        pole_mm=POLE,
        board_mm=(210.0, 150.0),
        response=seen.response,
    )


def pose(side: float) -> RigidTransform:
    target = MIDDLE - np.array([0.0, 55.0, 0.0])
    back = MIDDLE + 300 * side * CORNER / np.sqrt(3) - target
    return looking_from(back, target, float(np.linalg.norm(back)))


def photograph(side: float, shine: np.ndarray = SHINE) -> np.ndarray:
    where = pose(side)
    behind = Response().linearise(board_seen(BOARD, LENS, where)).numpy()
    light = picture_of_faces(probe(), lambda cells, _points: shine[cells], LENS, where, behind)
    return Response().encode(torch.from_numpy(light.astype(np.float32)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two opposite pictures, and the files of camera, board and probe."""
    folder = tmp_path_factory.mktemp("partitions")
    save_board(folder / "board.json", BOARD)
    save_intrinsics(folder / "camera.json", LENS)
    write_json(folder / "assembly.json", standing().to_json())
    Image.fromarray(photograph(1.0)).save(folder / "upper.png")
    Image.fromarray(photograph(-1.0)).save(folder / "lower.png")
    return folder


def capture(folder: Path, out: Path, *arguments: object) -> int:
    command = ["probe", "partitions", "capture", *map(str, arguments), "--out", str(out)]
    if "--assembly" not in command:
        command += ["--assembly", str(folder / "assembly.json")]
    for name in ("camera", "board"):
        command += [f"--{name}", str(folder / f"{name}.json")]
    return main(command)


@pytest.fixture
def no_other_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of other things than the turn: one probe, sought where the assembly says."""
    monkeypatch.setattr(PartitionAssembly, "placed", lambda _: probe())
    monkeypatch.setattr(PartitionAligner, "best", lambda self, _: OutlineAligner.best(self, 0.0))


def capture_of_turned(folder: Path, degrees: float) -> tuple[Path, str]:
    """By both pictures, from an assembly that is turned by so much; (results, what was said)."""
    stand = standing().board_from_probe
    turn = torch.tensor([0, np.radians(degrees), 0, 0, 0, 0], dtype=torch.float64)
    turned = RigidTransform.from_vector(turn).about(stand.translation) @ stand
    assembly, out = folder / f"turned{degrees}.json", folder / f"both{degrees}"
    write_json(assembly, replace(standing(), board_from_probe=turned).to_json())
    pictures = [folder / "upper.png", folder / "lower.png"]
    with redirect_stdout(io.StringIO()) as said:
        assert capture(folder, out, *pictures, "--assembly", assembly) == 0
    return out, said.getvalue()


@pytest.fixture(scope="module")
def captured(folder: Path) -> tuple[Path, str]:
    return capture_of_turned(folder, -17.0)


def check_all_is_found(out: Path, said: str) -> None:
    assert "degrees (or a multiple of 120 more" in said
    found = load_capture(out / "shading.json")
    assert found.known.all()
    np.testing.assert_allclose(found.shading, SHINE, rtol=0.02)
    stand = standing().board_from_probe
    left = load_partition_assembly(out / "assembly.json").board_from_probe @ stand.inverse()
    assert left.angle_deg < 1.5
    assert left.about(-stand.translation).translation.norm() < 1.0
    report = json.loads((out / "capture.json").read_text())
    assert report["captured"] == report["cells"] == 6
    assert len(report["pictures"]) == 2
    assert report["warnings"] == report["left_out"] == []


def test_two_opposite_pictures_tell_the_light_of_six_cells_and_the_turn(captured):
    check_all_is_found(*captured)


@pytest.mark.slow
def test_turned_the_other_way_as_well(folder: Path) -> None:
    check_all_is_found(*capture_of_turned(folder, 8.0))


@pytest.fixture(scope="module")
def without_probe(folder: Path) -> Path:
    Image.fromarray(board_seen(BOARD, LENS, pose(1.0))).save(folder / "board.png")
    return folder / "board.png"


@pytest.mark.usefixtures("no_other_turns")
def test_a_capture_is_continued(folder, without_probe, tmp_path, capsys):
    """First of the upper cells, where one is darker than later, and another over-exposed."""
    shine = SHINE.copy()
    shine[0] *= 0.6
    shine[2] = 1.5
    Image.fromarray(photograph(1.0, shine)).save(tmp_path / "other.png")
    Image.new("RGB", (640, 480), (90, 90, 90)).save(tmp_path / "grey.png")
    grey = torch.full((3,), 0.7, dtype=torch.float64)
    save_albedo(tmp_path / "a.json", KernelAlbedo(rgb=grey, error=0 * grey, reference="card"))
    albedo, out = ["--albedo", tmp_path / "a.json"], tmp_path / "c"
    first = [tmp_path / "other.png", without_probe, tmp_path / "grey.png"]
    assert capture(folder, out, *first, *albedo) == 0
    told = capsys.readouterr()
    assert "2 of 6 cells from 1 pictures" in told.out
    for said in (
        "board.png: no probe where the others show it",
        "grey.png: no marker board in view",
        "3 of 6 cells are seen in no picture: cell 1 towards (",
        "1 cells are over-exposed in every picture: cell 2 towards",
    ):
        assert said in told.err
    found = load_capture(out / "shading.json")
    assert found.saturated.tolist() == [False, False, True, False, False, False]
    assert found.known.tolist() == [True, False, False, False, False, True]
    assert torch.equal(found.albedo, grey)

    both = [folder / "upper.png", folder / "lower.png"]
    assert capture(folder, out, *both) == 2  # not by accident
    assert capture(folder, out, *both, "--more") == 2
    assert "captured with another --albedo" in capsys.readouterr().err
    assert capture(folder, out, *both, "--more", *albedo) == 0
    told = capsys.readouterr()
    differ = re.search(r"1 of 6 cells differ .* by up to (\d+)%: cell 0 towards", told.err)
    assert differ is not None
    assert 64 <= int(differ[1]) <= 69  # 0.4 of 0.6
    assert "the light moved" in told.err
    assert load_capture(out / "shading.json").known.all()
    report = json.loads((out / "capture.json").read_text())
    names = [Path(name).name for name in report["pictures"]]
    assert names == ["other.png", "upper.png", "lower.png"]


def test_cells_that_are_missing_get_their_neighbours_light(captured: tuple[Path, str]) -> None:
    found = load_capture(captured[0] / "shading.json")
    model = PartitionProbe(CELLS, 0.8, response=standing().response)
    said: list[str] = []
    whole = completed_shading(found, standing(), model, said.append)
    np.testing.assert_array_equal(whole, found.shading)
    assert said == []
    one_less = replace(found, area_px=found.area_px * (torch.arange(6) != 2))
    filled = completed_shading(one_less, standing(), model, said.append)
    light = model.light(filled[None])[0]
    torch.testing.assert_close(light[2], light[[0, 1, 4, 5]].mean(0), rtol=1e-6, atol=0)
    np.testing.assert_array_equal(filled[[0, 1, 3, 4, 5]], found.shading[[0, 1, 3, 4, 5]])
    assert "1 of 6 cells were not captured" in said[0]
    assert "cell 2 towards" in said[0]


@pytest.mark.usefixtures("no_other_turns")
class TestRefusals:
    def test_no_board_in_view(self, folder, tmp_path, capsys):
        Image.new("RGB", (640, 480), (90, 90, 90)).save(tmp_path / "grey.png")
        assert capture(folder, tmp_path / "c", tmp_path / "grey.png") == 2
        told = capsys.readouterr().err
        assert "none of 1 pictures can be used (no marker board in view)" in told
        assert told.count("\n") == 1
        assert not (tmp_path / "c").exists()

    def test_a_board_without_the_probe(self, folder, without_probe, tmp_path, capsys):
        assert capture(folder, tmp_path / "c", without_probe) == 2
        told = capsys.readouterr().err
        assert "no probe where the assembly says, in any of 1 pictures" in told
        assert told.count("\n") == 1
        assert not (tmp_path / "c").exists()

    def test_without_manifold3d_no_picture_is_read(self, folder, tmp_path, capsys, monkeypatch):
        monkeypatch.setitem(sys.modules, "manifold3d", None)
        assert capture(folder, tmp_path / "c", tmp_path / "none.png") == 1
        assert "skylight-lighting[print]" in capsys.readouterr().err

    def test_over_exposure(self, folder, tmp_path, capsys):
        Image.fromarray(photograph(1.0, np.full((6, 3), 3.0))).save(tmp_path / "burnt.png")
        assert capture(folder, tmp_path / "c", tmp_path / "burnt.png") == 2
        assert "all 3 faces in view are over-exposed: expose shorter" in capsys.readouterr().err

    def test_another_board_or_probe(self, folder, captured, tmp_path, capsys):
        other = replace(standing(), board_mm=(175.0, 125.0))
        write_json(tmp_path / "a.json", other.to_json())
        upper, told = folder / "upper.png", ["--assembly", tmp_path / "a.json"]
        assert capture(folder, tmp_path / "c", upper, *told) == 2
        assert "stands on a board of 175 x 125 mm" in capsys.readouterr().err
        cells = Cells.of(named_design("14d"))
        other = replace(
            standing(),
            cells=cells,
            board_from_probe=RigidTransform.from_numpy(standing_rotation(cells), MIDDLE),
            response=torch.diag(cells.facing),
        )
        write_json(tmp_path / "a.json", other.to_json())
        assert capture(folder, captured[0], upper, "--more", *told) == 2
        assert "'6d' with 6 cells, not of this '14d' with 14" in capsys.readouterr().err

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["--albedo", "2"], "an albedo is above 0 and at most 1"),
            (["--albedo", "none.json"], "cannot read none.json"),
            (["--frames", "0"], "at least 1 frame"),
            (["--more"], "no capture to continue"),
            (["--webcam", "0"], "only one of them"),
        ],
    )
    def test_what_makes_no_sense(self, folder, tmp_path, capsys, arguments, message):
        assert capture(folder, tmp_path / "c", folder / "upper.png", *arguments) == 2
        assert message in capsys.readouterr().err


class TestAlbedo:
    def test_a_chart_is_found(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        Image.fromarray(photo_of_chart()).save(tmp_path / "chart.png")
        save_response(tmp_path / "response.json", GAMMA)
        file = tmp_path / "albedo.json"
        command = ["probe", "partitions", "albedo", str(tmp_path / "chart.png"), "--patch"]
        command += [*map(str, PATCH), "--response", str(tmp_path / "response.json")]
        assert main([*command, "--out", str(file)]) == 0
        assert "by a ColorChecker" in capsys.readouterr().out
        np.testing.assert_allclose(read_albedo(str(file)).rgb, MATERIAL, rtol=0.01)
        assert main([*command, "--card", "600", "30", "125", "100"]) == 2
        assert "--card and --card-albedo together" in capsys.readouterr().err

    def test_uneven_light_is_doubted(self, tmp_path: Path) -> None:
        """Twice the light on one side of the material, a grey card beside it."""
        photo = np.full((20, 40, 3), 100, np.uint8)
        photo[:, :20] = np.linspace(80, 160, 20, dtype=np.uint8)[:, None]
        Image.fromarray(photo).save(tmp_path / "card.png")
        said: list[str] = []
        measure_albedo(
            tmp_path / "card.png",
            tmp_path / "a.json",
            patch=(0, 0, 20, 20),
            card=(20, 0, 20, 20),
            card_albedo=0.18,
            response=None,
            warn=said.append,
        )
        assert "the albedo is known to" in said[0]


class TestCells:
    def test_designs_are_listed(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["probe", "partitions", "cells"]) == 0
        told = capsys.readouterr().out
        assert "14d-indoor            14 cells" in told

    def test_a_sun_path_is_drawn_and_saved(self, tmp_path, capsys):
        command = ["probe", "partitions", "cells", "6d", "--path-cells", "6", "--size", "40"]
        command += ["--lat", "55.95", "--lon", "-3.19", "--date", "2026-06-21"]
        command += ["--out", str(tmp_path / "c.png"), "--save", str(tmp_path / "d.json")]
        assert main(command) == 0
        saved = load_design(tmp_path / "d.json")
        assert saved.oriented
        assert f"{saved.name}: {saved.count} cells, to be placed" in capsys.readouterr().out
        assert Image.open(tmp_path / "c.png").size == (80, 40)
        # the file is a design like any other
        assert main(["probe", "partitions", "cells", str(tmp_path / "d.json")]) == 0
        assert f"{saved.count} cells" in capsys.readouterr().out

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["6d", "--lat", "10"], "--lat, --lon and --date together"),
            (["--out", "x.png"], "name a design"),
            (["none.json"], "cannot read none.json"),
        ],
    )
    def test_what_makes_no_sense(self, capsys, arguments, message):
        assert main(["probe", "partitions", "cells", *arguments]) == 2
        assert message in capsys.readouterr().err

    @pytest.mark.parametrize(
        ("out", "save", "size", "message"),
        [
            (Path("x.jpg"), None, 480, "written as .png"),
            (None, Path("x.txt"), 480, "written as .json"),
            (None, None, 4, "16 to 4000 pixels"),
        ],
    )
    def test_files_that_are_not_written(self, out, save, size, message):
        with pytest.raises(InputError, match=message):
            write_cells(named_design("6d"), out, save, size=size)


def test_sizes_that_do_not_fit_are_no_print(tmp_path, capsys):
    command = ["probe", "partitions", "print", "6d", "--kernel-mm", "9", "--outer-mm", "20"]
    assert main([*command, "--out", str(tmp_path / "p")]) == 2
    assert "make outer_mm 28 or more" in capsys.readouterr().err
    assert not (tmp_path / "p").exists()


class TestOutline:
    def test_a_cube_has_its_edges_seen_from_both_faces(self) -> None:
        outline = outline_of(WallNet.of(CELLS), SIZES)
        coordinates = np.sort(np.abs(outline.places), axis=1)
        np.testing.assert_allclose(coordinates[:, 2], 9.0)
        np.testing.assert_allclose(coordinates[:, 1], 9.0, atol=0.1)
        assert (coordinates[:, 0] < 8.0).all()  # corners belong to three walls
        np.testing.assert_allclose((outline.places * outline.outward).sum(1), 9.0)
        # the face lies towards its middle
        assert (((9.0 * outline.outward - outline.places) * outline.into).sum(1) > 8.9).all()
        np.testing.assert_allclose((outline.into * outline.along).sum(1), 0.0, atol=1e-12)

    def test_a_cube_on_its_corner_looks_alike_every_third_turn(self) -> None:
        assert symmetry(outline_of(WallNet.of(CELLS, TURN), SIZES)) == 3
        assert symmetry(outline_of(WallNet.of(CELLS), SIZES)) == 4
