"""A partition probe's capture by the command line, on drawn pictures; and its other first verbs."""

import json
import re
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
from skylight.probes.cameras._intrinsics import FLIP, Intrinsics, save_intrinsics
from skylight.probes.cameras._pose import OPENCV_FROM_BOARD
from skylight.probes.cameras._response import Response, save_response
from skylight.probes.partitions._alignment import PartitionAligner
from skylight.probes.partitions._capture_files import completed_shading
from skylight.probes.partitions._captured import load_capture
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._kernel_albedo import read_albedo
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
from skylight.probes.partitions.printed._solids import ProbeSizes
from skylight.sphere._rotation import RigidTransform
from tests.probes.cameras.scenes import picture_of_board
from tests.probes.partitions.pictures import looking_from, picture_of_faces
from tests.probes.partitions.test_kernel_albedo import (
    GAMMA,
    MATERIAL,
    PATCH,
    photo as photo_of_chart,
)

BOARD = Board(columns=7, rows=5, square_mm=30.0, marker_mm=22.0)
LENS = Intrinsics(width=640, height=480, fx=560.0, fy=560.0, cx=322.0, cy=238.0, k1=-0.08)
MIDDLE = np.array([105.0, 150.0, 75.0])
CELLS = Cells.of(named_design("6d"))
SHINE = np.random.default_rng(8).uniform(0.05, 0.7, (6, 3))
# one corner of the cube is up; this is another, and then the one across
CORNER = standing_rotation(CELLS) @ np.array([1.0, 1.0, -1.0])


def standing() -> PartitionAssembly:
    return PartitionAssembly(
        cells=CELLS,
        sizes=ProbeSizes(outer_mm=60.0, kernel_mm=9.0),
        board_from_probe=RigidTransform.from_numpy(standing_rotation(CELLS), MIDDLE),
        pole_mm=(105.0, 75.0, 3.0, 120.0),
        board_mm=(210.0, 150.0),
        response=response(),
    )


@cache
def response() -> torch.Tensor:
    parts = probe_parts(
        CELLS,
        ProbeSizes(outer_mm=60.0, kernel_mm=9.0),
        rotation=standing_rotation(CELLS),
        pole_mm=6.0,
    )
    sizes = ProbeSizes(outer_mm=60.0, kernel_mm=9.0)
    placed = placed_parts(parts, sizes, np.zeros(3), (0.0, 0.0, 3.0, -40.0))
    return measure_visibility(
        CELLS,
        placed.caster,
        centres=placed.face_centres,
        radii=placed.face_radii,
        rotation=standing_rotation(CELLS),
        directions=4000,
    ).response


@cache
def probe() -> PlacedPartitions:
    return standing().placed()


def pose(side: float) -> RigidTransform:
    target = MIDDLE - np.array([0.0, 55.0, 0.0])
    back = MIDDLE + 300 * side * CORNER / np.sqrt(3) - target
    return looking_from(back, target, float(np.linalg.norm(back)))


def photograph(side: float, shine: np.ndarray = SHINE) -> np.ndarray:
    where = pose(side)
    board = picture_of_board(
        BOARD,
        LENS,
        FLIP @ where.rotation.numpy() @ OPENCV_FROM_BOARD.T,
        FLIP @ where.translation.numpy(),
    )
    behind = Response().linearise(board).numpy()
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


@pytest.fixture(autouse=True)
def no_other_turns(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The probe is sought where the assembly says, but by ``captured`` and where it was turned."""
    if "turned" not in request.fixturenames:
        monkeypatch.setattr(
            PartitionAligner, "best", lambda self, _: OutlineAligner.best(self, 0.0)
        )


@pytest.fixture(scope="module")
def captured(folder: Path) -> Path:
    out = folder / "both"
    assert capture(folder, out, folder / "upper.png", folder / "lower.png") == 0
    return out


def test_two_opposite_pictures_tell_the_light_of_six_cells(captured: Path) -> None:
    found = load_capture(captured / "shading.json")
    assert found.known.all()
    np.testing.assert_allclose(found.shading, SHINE, rtol=0.02, atol=0.002)
    report = json.loads((captured / "capture.json").read_text())
    assert report["captured"] == report["cells"] == 6
    assert len(report["pictures"]) == 2
    assert report["warnings"] == report["left_out"] == []
    assert (captured / "assembly.json").exists()


def test_a_capture_is_continued(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "c"
    assert capture(folder, out, folder / "upper.png") == 0
    told = capsys.readouterr()
    assert "3 of 6 cells from 1 pictures" in told.out
    assert "3 of 6 cells are seen in no picture: cell 1 towards (" in told.err
    assert capture(folder, out, folder / "lower.png") == 2  # not by accident
    assert capture(folder, out, folder / "lower.png", "--more", "--albedo", "0.7") == 2
    assert "captured with another --albedo" in capsys.readouterr().err
    assert capture(folder, out, folder / "lower.png", "--more") == 0
    assert load_capture(out / "shading.json").known.all()
    report = json.loads((out / "capture.json").read_text())
    assert [Path(name).name for name in report["pictures"]] == ["upper.png", "lower.png"]


def test_cells_that_are_missing_get_their_neighbours_light(captured: Path) -> None:
    found = load_capture(captured / "shading.json")
    probe = PartitionProbe(CELLS, 0.8, response=standing().response)
    said: list[str] = []
    whole = completed_shading(found, standing(), probe, said.append)
    np.testing.assert_array_equal(whole, found.shading)
    assert said == []
    one_less = replace(found, area_px=found.area_px * (torch.arange(6) != 2))
    filled = completed_shading(one_less, standing(), probe, said.append)
    light = probe.light(filled[None])[0]
    torch.testing.assert_close(light[2], light[[0, 1, 4, 5]].mean(0), rtol=1e-6, atol=0)
    np.testing.assert_array_equal(filled[[0, 1, 3, 4, 5]], found.shading[[0, 1, 3, 4, 5]])
    assert "1 of 6 cells were not captured" in said[0]
    assert "cell 2 towards" in said[0]
    few = replace(found, area_px=found.area_px * (torch.arange(6) < 2))
    with pytest.raises(InputError, match="only 2 of 6 cells"):
        completed_shading(few, standing(), probe, said.append)


@pytest.mark.parametrize("turned", [-17.0, 8.0])
def test_a_probe_that_was_turned_is_found_again(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], turned: float
) -> None:
    true = standing()
    turn = torch.tensor([0, np.radians(turned), 0, 0, 0, 0], dtype=torch.float64)
    stand = true.board_from_probe
    wrong = replace(
        true,
        board_from_probe=RigidTransform.from_vector(turn).about(stand.translation) @ stand,
    )
    write_json(tmp_path / "a.json", wrong.to_json())
    pictures = [folder / "upper.png", folder / "lower.png"]
    out = tmp_path / "c"
    assert capture(folder, out, *pictures, "--assembly", tmp_path / "a.json") == 0
    assert "degrees (or a multiple of 120 more" in capsys.readouterr().out
    np.testing.assert_allclose(load_capture(out / "shading.json").shading, SHINE, rtol=0.02)
    found = load_partition_assembly(out / "assembly.json")
    left = found.board_from_probe @ stand.inverse()
    assert left.angle_deg < 1.5
    assert left.about(-stand.translation).translation.norm() < 1.0


def test_a_board_without_the_probe_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = pose(1.0)
    board = picture_of_board(
        BOARD,
        LENS,
        FLIP @ where.rotation.numpy() @ OPENCV_FROM_BOARD.T,
        FLIP @ where.translation.numpy(),
    )
    Image.fromarray(board).save(tmp_path / "board.png")
    assert capture(folder, tmp_path / "c", tmp_path / "board.png") == 2
    told = capsys.readouterr().err
    assert "no probe where the assembly says, in any of 1 pictures" in told
    assert told.count("\n") == 1
    assert not (tmp_path / "c").exists()
    both = [folder / "upper.png", tmp_path / "board.png", folder / "lower.png"]
    assert capture(folder, tmp_path / "c", *both) == 0
    assert "board.png: no probe where the others show it" in capsys.readouterr().err
    assert load_capture(tmp_path / "c" / "shading.json").known.all()


@pytest.fixture(scope="module")
def other(folder: Path) -> Path:
    """Of the upper cells, where one got darker and another is over-exposed."""
    shine = SHINE.copy()
    shine[0] *= 0.6
    shine[2] = 1.5
    Image.fromarray(photograph(1.0, shine)).save(folder / "other.png")
    return folder / "other.png"


class TestWarnings:
    def test_light_that_moved_is_said(
        self, folder: Path, other: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        pictures = [folder / "upper.png", folder / "lower.png", other]
        assert capture(folder, tmp_path / "c", *pictures) == 0
        told = capsys.readouterr().err
        said = re.search(r"1 of 6 cells differ .* by up to (\d+)%: cell 0 towards", told)
        assert said is not None
        assert 38 <= int(said[1]) <= 42
        assert "the light moved" in told

    def test_over_exposed_cells_are_said(
        self, folder: Path, other: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert capture(folder, tmp_path / "c", other, folder / "lower.png") == 0
        told = capsys.readouterr().err
        assert "1 cells are over-exposed in every picture: cell 2 towards" in told
        found = load_capture(tmp_path / "c" / "shading.json")
        assert found.saturated.tolist() == [False, False, True, False, False, False]
        assert not found.known[2]

    def test_pictures_without_the_board_are_left_out(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        Image.new("RGB", (640, 480), (90, 90, 90)).save(tmp_path / "grey.png")
        assert capture(folder, tmp_path / "c", folder / "upper.png", tmp_path / "grey.png") == 0
        assert "grey.png: no marker board in view" in capsys.readouterr().err


class TestRefusals:
    def test_no_board_in_view(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        Image.new("RGB", (640, 480), (90, 90, 90)).save(tmp_path / "grey.png")
        assert capture(folder, tmp_path / "c", tmp_path / "grey.png") == 2
        told = capsys.readouterr().err
        assert "none of 1 pictures can be used (no marker board in view)" in told
        assert told.count("\n") == 1
        assert not (tmp_path / "c").exists()

    def test_over_exposure(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        Image.fromarray(photograph(1.0, np.full((6, 3), 3.0))).save(tmp_path / "burnt.png")
        assert capture(folder, tmp_path / "c", tmp_path / "burnt.png") == 2
        assert "all 3 faces in view are over-exposed: expose shorter" in capsys.readouterr().err

    def test_another_board_or_probe(
        self, folder: Path, captured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
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
        assert capture(folder, captured, upper, "--more", *told) == 2
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
    def test_what_makes_no_sense(
        self,
        folder: Path,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
        arguments: list[str],
        message: str,
    ) -> None:
        assert capture(folder, tmp_path / "c", folder / "upper.png", *arguments) == 2
        assert message in capsys.readouterr().err


class TestAlbedo:
    def test_a_chart_is_found_and_the_file_is_used(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        Image.fromarray(photo_of_chart()).save(tmp_path / "chart.png")
        save_response(tmp_path / "response.json", GAMMA)
        file = tmp_path / "albedo.json"
        command = ["probe", "partitions", "albedo", str(tmp_path / "chart.png"), "--patch"]
        command += [*map(str, PATCH), "--response", str(tmp_path / "response.json")]
        assert main([*command, "--out", str(file)]) == 0
        assert "by a ColorChecker" in capsys.readouterr().out
        np.testing.assert_allclose(read_albedo(str(file)).rgb, MATERIAL, rtol=0.01)
        assert capture(folder, tmp_path / "c", folder / "upper.png", "--albedo", file) == 0
        found = load_capture(tmp_path / "c" / "shading.json")
        np.testing.assert_array_equal(found.albedo, read_albedo(str(file)).rgb)

    def test_a_wrong_response_is_doubted(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        Image.fromarray(photo_of_chart()).save(tmp_path / "chart.png")
        save_response(tmp_path / "response.json", Response(kind="gamma", gamma=0.5))
        command = ["probe", "partitions", "albedo", str(tmp_path / "chart.png"), "--patch"]
        command += [*map(str, PATCH), "--response", str(tmp_path / "response.json")]
        assert main([*command, "--out", str(tmp_path / "a.json")]) == 0
        assert "the albedo is known to" in capsys.readouterr().err

    def test_a_card_needs_its_albedo(self, capsys: pytest.CaptureFixture[str]) -> None:
        command = ["probe", "partitions", "albedo", "chart.png", "--patch"]
        command += [*map(str, PATCH), "--card", "1200", "60", "250", "200"]
        assert main(command) == 2
        assert "--card and --card-albedo together" in capsys.readouterr().err


class TestCells:
    def test_designs_are_listed(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["probe", "partitions", "cells"]) == 0
        told = capsys.readouterr().out
        assert "14d-indoor            14 cells" in told

    def test_a_sun_path_is_drawn_and_saved(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
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
            (["7d"], "no design is called '7d'"),
            (["6d", "--lat", "10"], "--lat, --lon and --date together"),
            (["6d", "--lat", "95", "--lon", "0", "--date", "2026-06-21"], "is no place"),
            (["6d", "--lat", "5", "--lon", "0", "--date", "midsummer"], "is no day"),
            (["6d", "--out", "x.jpg"], "written as .png"),
            (["6d", "--save", "x.txt"], "written as .json"),
            (["6d", "--size", "4"], "16 to 4000 pixels"),
            (["--out", "x.png"], "name a design"),
            (["none.json"], "cannot read none.json"),
        ],
    )
    def test_what_makes_no_sense(
        self, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
    ) -> None:
        assert main(["probe", "partitions", "cells", *arguments]) == 2
        assert message in capsys.readouterr().err


def test_sizes_that_do_not_fit_are_no_print(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = [
        "probe",
        "partitions",
        "print",
        "6d",
        "--kernel-mm",
        "9",
        "--out",
        str(tmp_path / "p"),
    ]
    assert main([*command, "--outer-mm", "20"]) == 2
    assert "make outer_mm 28 or more" in capsys.readouterr().err
    assert main([*command, "--lon", "3"]) == 2
    assert "--lat, --lon and --date together" in capsys.readouterr().err
    assert not (tmp_path / "p").exists()
