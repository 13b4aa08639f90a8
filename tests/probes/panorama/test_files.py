"""`skylight probe stitch`: pictures in, a probe and lines out, one line on failure."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from skylight.cli import main
from skylight.errors import InputError
from skylight.io._files import read_environment_map
from skylight.io._hdr import write_radiance
from skylight.probes.panorama._brackets import find_brackets, read_turns
from tests.cli.test_cli import one_line
from tests.turning_camera import HEAD, LENS, SUN_IRRADIANCE, TIMES, pictures, sun_irradiance
from tests.virtual_camera import expose

RESULTS = {"probe.exr", "probe.hdr", "probe.png", "probe.json", "report.png"}
LEVEL = range(8, 16)  # the shots at the horizon


def save(path: Path, codes: np.ndarray, seconds: float | None) -> None:
    exif = Image.Exif()
    if seconds is not None:
        exif[ExifTags.IFD.Exif] = {ExifTags.Base.ExposureTime: seconds}
    Image.fromarray(codes).save(path, exif=exif)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shots at the horizon, in a row."""
    made, rng = tmp_path_factory.mktemp("shots"), np.random.default_rng(1)
    for number in LEVEL:
        for at, time in enumerate(TIMES):
            image = expose(pictures()[1][number], time, rng, 8, "").image
            save(made / f"{number:02d}_{at}.png", image, time)
    return made


def failure(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    assert main(["probe", "stitch", *map(str, arguments)]) == 2
    return one_line(capsys)


@pytest.fixture(scope="module")
def out(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out")
    assert main(["probe", "stitch", str(folder), "--height", "64", "--out", str(out)]) == 0
    return out


class TestResults:
    def test_files(self, out: Path) -> None:
        assert {path.name for path in out.iterdir()} == RESULTS
        told = json.loads((out / "probe.json").read_text())
        assert len(told["views"]) == len(LEVEL)
        assert told["views"][0]["seconds"] == pytest.approx(TIMES, rel=1e-3)
        assert told["lens"]["focal_length_px"] == pytest.approx(LENS.focal_px, rel=0.02)
        assert told["response"]["kind"] == "srgb"
        assert told["clipped"] is None
        assert 0.3 < told["unseen_share"] < 0.6

    def test_the_sun(self, out: Path) -> None:
        """Of the map turned to the world by what probe.json says of the first shot."""
        told = json.loads((out / "probe.json").read_text())
        turn = np.array(told["views"][0]["world_from_camera"]) @ pictures()[0][LEVEL[0]].T
        lit = sun_irradiance(read_environment_map(out / "probe.exr"), turn)
        np.testing.assert_allclose(lit, SUN_IRRADIANCE * TIMES[-1], rtol=0.06)

    def test_exposures_of_their_own(self, out: Path, folder: Path, tmp_path: Path) -> None:
        """One direction's bracket is half as long: the light is the same."""
        odd, rng = 11, np.random.default_rng(2)
        for number in LEVEL:
            inner = tmp_path / "shots" / f"{number:02d}"
            inner.mkdir(parents=True)
            for at, time in enumerate(TIMES):
                if number == odd:
                    image = expose(pictures()[1][number], time / 2, rng, 8, "").image
                    save(inner / f"{at}.png", image, time / 2)
                else:
                    shutil.copy(folder / f"{number:02d}_{at}.png", inner)
        made = tmp_path / "made"
        arguments = ["probe", "stitch", str(tmp_path / "shots"), "--height", "64"]
        assert main([*arguments, "--out", str(made)]) == 0
        same, light = (read_environment_map(each / "probe.exr") for each in (out, made))
        told = json.loads((made / "probe.json").read_text())["views"][odd - LEVEL[0]]
        assert told["seconds"] == pytest.approx([time / 2 for time in TIMES], rel=1e-3)
        ahead = -np.array(told["world_from_camera"])[:, 2]
        near = light.grid.directions.numpy() @ ahead > np.cos(np.radians(15))
        ratio = light.flat.numpy()[near] / same.flat.numpy()[near]
        assert np.median(ratio) == pytest.approx(1, abs=0.02)

    def test_a_unit_of_merged_files(self, out: Path, tmp_path: Path) -> None:
        for number in LEVEL[:2]:
            light = pictures()[1][number]
            write_radiance(tmp_path / f"{number:02d}.hdr", light)
        made = tmp_path / "made"
        assert main(["probe", "stitch", str(tmp_path), "--height", "32", "--out", str(made)]) == 0
        units = [json.loads((each / "probe.json").read_text())["unit"] for each in (made, out)]
        assert units == ["that of the merged files", "1 saturates the longest exposure"]

    def test_doubts(self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """One exposure, a folder for each shot, and turns that name where they looked."""
        shots = tmp_path / "shots"
        for number in LEVEL:
            inner = shots / f"{number:02d}"
            inner.mkdir(parents=True)
            shutil.copy(folder / f"{number:02d}_2.png", inner)
        turns = tmp_path / "turns.csv"
        rows = [HEAD.angles_deg()[number] for number in LEVEL]
        lines = ["azimuth_deg,elevation_deg", *(f"{a},{e}" for a, e in rows)]
        turns.write_text("\n".join(lines))
        options = ["--turns", str(turns), "--focal-length-px", "120", "--height", "32"]
        out = tmp_path / "out"
        assert main(["probe", "stitch", str(shots), *options, "--out", str(out)]) == 0
        captured = capsys.readouterr()
        assert "from 8 of 8 directions" in captured.out
        assert "one exposure only" in captured.err
        assert "the shortest exposure is saturated over" in captured.err
        assert "is in no shot" in captured.err


class TestBrackets:
    def test_a_row_of_equal_brackets(self, folder: Path) -> None:
        found = find_brackets([folder], None, None)
        assert [len(each.files) for each in found] == [4] * 8
        assert found[0].files[0].name == "08_0.png"
        assert found[7].seconds == pytest.approx(TIMES, rel=1e-3)

    def test_times_by_hand(self, folder: Path) -> None:
        (found, *more) = find_brackets([folder], "1,2,4,8", None)
        assert found.seconds == (1, 2, 4, 8)
        assert len(more) == 7

    def test_one_is_missing(self, folder: Path) -> None:
        files = sorted(folder.iterdir())
        with pytest.raises(InputError, match="no whole number of brackets of 4"):
            find_brackets(files[:-1], None, None)
        with pytest.raises(InputError, match="have the same exposure"):
            find_brackets([*files[:2], *files[3:], files[0]], None, None)

    def test_merged_files_are_a_direction_each(self, tmp_path: Path) -> None:
        for name in "ab":
            (tmp_path / f"{name}.exr").touch()
        found = find_brackets([tmp_path], None, None)
        assert [each.seconds for each in found] == [None, None]

    def test_pictures_beside_folders_of_pictures(self, folder: Path, tmp_path: Path) -> None:
        inner = tmp_path / "00"
        inner.mkdir()
        for at in range(4):
            shutil.copy(folder / f"08_{at}.png", inner)
        shutil.copy(folder / "09_0.png", tmp_path / "stray.png")
        with pytest.raises(InputError, match=r"pictures \(stray.png\) and folders .* \(00\)"):
            find_brackets([tmp_path], None, None)
        # a folder of something else does not matter
        (tmp_path / "stray.png").unlink()
        (tmp_path / "notes").mkdir()
        assert len(find_brackets([tmp_path], None, None)) == 1

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("a,b\n1,2\n", "it needs the columns"),
            ("azimuth_deg,elevation_deg\n1,2\n", "1 rows for 2 directions"),
            ("azimuth_deg,elevation_deg\n1,2\n3,x\n", "row 2: could not convert"),
            ("azimuth_deg,elevation_deg\n1,2\n3,95\n", "no direction"),
            ("azimuth_deg,elevation_deg\n1,2\n3,nan\n", "no direction"),
        ],
    )
    def test_turns_that_cannot_be(self, text: str, message: str, tmp_path: Path) -> None:
        path = tmp_path / "turns.csv"
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            read_turns(path, 2)

    @pytest.mark.parametrize("row", [",", "", " , ", "  "])
    @pytest.mark.parametrize("end", ["", "\n", "\n\n"])
    def test_a_turn_that_is_not_known(self, row: str, end: str, tmp_path: Path) -> None:
        path = tmp_path / "turns.csv"
        path.write_text(f"azimuth_deg,elevation_deg\n{row}\n90,0{end}")
        assert list(read_turns(path, 2)) == [1]

    def test_turns_as_excel_writes_them(self, tmp_path: Path) -> None:
        path = tmp_path / "turns.csv"
        path.write_bytes(b"\xef\xbb\xbfazimuth_deg,elevation_deg\r\n0,0\r\n90,0\r\n")
        assert list(read_turns(path, 2)) == [0, 1]


class TestRefusals:
    def test_options(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        out = ["--out", tmp_path / "out"]
        assert "--height must be" in failure(capsys, folder, *out, "--height", "4")
        assert "--bracket must be" in failure(capsys, folder, *out, "--bracket", "0")
        assert "--focal-length-px must" in failure(capsys, folder, *out, "--focal-length-px", "-1")
        lone = folder / "08_0.png", folder / "09_0.png", "--bracket", "1"
        assert "must be above 0, got 0 in" in failure(capsys, *lone, *out, "--times", "0")
        assert "No such file" in failure(capsys, tmp_path / "none.png", *out, "--times", "1")
        assert not (tmp_path / "out").exists()

    def test_no_pictures(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert "no pictures in it" in failure(capsys, tmp_path, "--out", tmp_path / "out")

    def test_no_overlap(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        files = [folder / f"{number:02d}_{at}.png" for number in (8, 12) for at in range(4)]
        line = failure(capsys, *files, "--out", tmp_path / "out")
        assert "no two of 2 shots overlap" in line

    def test_mixed_sizes(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        for at in range(4):
            image = Image.open(folder / f"09_{at}.png").convert("RGB")
            save(tmp_path / f"small{at}.png", np.array(image)[:100], TIMES[at])
        files = [*(folder / f"08_{at}.png" for at in range(4)), *sorted(tmp_path.glob("*.png"))]
        line = failure(capsys, *files, "--response", "srgb", "--out", tmp_path / "out")
        assert "has other measures than" in line
        assert "not all shots have its size" in failure(capsys, *files, "--out", tmp_path / "out")
