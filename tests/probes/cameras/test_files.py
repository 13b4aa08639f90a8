"""`skylight camera`: files in, files and one line out, one line on failure."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from skylight.cli import main
from skylight.errors import InputError
from skylight.probes.cameras._board import Board, load_board, save_board
from skylight.probes.cameras._exposure_files import exif_exposures, exposure_times
from skylight.probes.cameras._intrinsics import load_intrinsics
from skylight.probes.cameras._live import Frame
from skylight.probes.cameras._response import load_response
from tests.cli.test_cli import one_line
from tests.probes.cameras.scenes import LENS


@pytest.fixture(scope="module")
def folder(
    tmp_path_factory: pytest.TempPathFactory, board: Board, frames: list[Frame], blank: np.ndarray
) -> Path:
    folder = tmp_path_factory.mktemp("camera")
    save_board(folder / "board.json", board)
    for i in (1, 2, 3, 5):
        Image.fromarray(frames[i].image).save(folder / f"view{i}.jpg", quality=92)
    Image.fromarray(blank).save(folder / "nothing.jpg")
    return folder


class TestBoard:
    def test_page_and_measures(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        out = tmp_path / "sheet.svg"
        assert main(["camera", "board", str(out), "--columns", "5", "--rows", "6"]) == 0
        assert load_board(tmp_path / "sheet.json") == Board(columns=5, rows=6)
        (line,) = capsys.readouterr().out.splitlines()
        assert "5 x 6 squares, 125 x 150 mm on A4" in line

    def test_too_large(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["camera", "board", str(tmp_path / "a.pdf"), "--square-mm", "40"]) == 2
        assert "does not fit on A4" in one_line(capsys)
        assert list(tmp_path.iterdir()) == []


class TestCalibrate:
    def test_from_photos(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        photos = [str(folder / f"view{i}.jpg") for i in (1, 2, 3, 5)]
        arguments = [*photos, str(folder / "nothing.jpg"), "--board", str(folder / "board.json")]
        out = tmp_path / "camera.json"
        assert main(["camera", "calibrate", *arguments, "--out", str(out)]) == 0
        assert load_intrinsics(out).fx == pytest.approx(LENS.fx, rel=0.01)
        captured = capsys.readouterr()
        assert len(captured.out.splitlines()) == 1
        assert "nothing.jpg: the board was not found" in captured.err
        assert "only 4 pictures" in captured.err
        content = json.loads(out.read_text())["calibration"]
        assert len(content["views"]) == 4
        assert content["std"]["fx"] > 0

    def test_from_a_film(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        size = (LENS.width, LENS.height)
        code = cv2.VideoWriter.fourcc(*"MJPG")
        film = cv2.VideoWriter(str(tmp_path / "film.avi"), code, 10, size)
        for i in (1, 2, 3, 5):
            picture = cv2.imread(str(folder / f"view{i}.jpg"))
            assert picture is not None
            for _ in range(10):  # of each window of ten one frame is taken
                film.write(picture)
        film.release()
        out = tmp_path / "camera.json"
        arguments = ["--video", str(tmp_path / "film.avi"), "--board", str(folder / "board.json")]
        assert main(["camera", "calibrate", *arguments, "--out", str(out)]) == 0
        assert load_intrinsics(out).fx == pytest.approx(LENS.fx, rel=0.01)
        assert " 4 pictures" in capsys.readouterr().out

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ([], "give photos, --video or --webcam"),
            (["a.jpg", "--video", "b.mp4"], "only one of them"),
            (["--video", "none.mp4"], "no such file"),
            (["none.jpg"], "cannot read none.jpg"),
            (["none.jpg", "--board", "none.json"], "cannot read none.json"),
            (["none.jpg", "--out", "camera.yaml"], "written as .json"),
        ],
    )
    def test_refused(
        self,
        folder: Path,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
        arguments: list[str],
        message: str,
    ) -> None:
        monkeypatch.chdir(folder)
        assert main(["camera", "calibrate", *arguments]) == 2
        assert message in one_line(capsys)
        assert not (folder / "camera.json").exists()


class TestResponse:
    def photos(self, folder: Path, *, exif: bool) -> list[str]:
        light = np.repeat(np.geomspace(0.02, 4, 160)[None], 100, 0)
        out = []
        for number, time in enumerate((0.25, 0.5, 1.0)):
            codes = np.rint(255 * np.clip(light * time, 0, 1) ** (1 / 2.2)).astype(np.uint8)
            tags = Image.Exif()
            if exif:
                tags[0x8769] = {0x829A: time}  # Exif: ExposureTime
            out.append(str(folder / f"{number}.png"))
            Image.fromarray(np.repeat(codes[..., None], 3, 2)).save(out[-1], exif=tags)
        return out

    @pytest.mark.parametrize("exif", [True, False])
    def test_from_photos(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str], exif: bool
    ) -> None:
        out = tmp_path / "response.json"
        times = [] if exif else ["--times", "1/4,1/2,1"]
        photos = self.photos(tmp_path, exif=exif)
        assert main(["camera", "response", *photos, *times, "--out", str(out)]) == 0
        curve = load_response(out).curve
        assert curve is not None
        expected = (np.arange(40, 240) / 255) ** 2.2
        ratio = curve[1, 40:240] / expected
        assert np.abs(ratio / np.median(ratio) - 1).max() < 0.05
        assert "from 3 exposures, 4 to 1" in capsys.readouterr().out

    def test_times_that_are_missing(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert main(["camera", "response", *self.photos(tmp_path, exif=False)]) == 2
        assert "give --times" in one_line(capsys)

    def test_lists_of_times(self, tmp_path: Path) -> None:
        assert exposure_times("1/4,0.5,2") == [0.25, 0.5, 2.0]
        for text in ("", "1/0", "fast"):
            with pytest.raises(InputError, match="must be a list"):
                exposure_times(text)
        for part in ("0", "-1", "nan", "inf", "1e-400", "1/inf"):
            with pytest.raises(InputError, match=f"must be above 0, got {part} in '1/4, {part}'"):
                exposure_times(f"1/4, {part}")
        with pytest.raises(InputError, match="cannot read"):
            exif_exposures([tmp_path / "none.jpg"])

    def test_an_iso_that_was_not_fixed(self, tmp_path: Path) -> None:
        paths = [tmp_path / "a.jpg", tmp_path / "b.jpg"]
        for path, iso in zip(paths, (100, 200), strict=True):
            tags = Image.Exif()
            tags[0x8769] = {0x829A: 0.5, 0x8827: iso}
            Image.new("RGB", (40, 40)).save(path, exif=tags)
        with pytest.raises(InputError, match=r"b\.jpg: .*ISO"):
            exif_exposures(paths)
