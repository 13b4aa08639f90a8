"""`skylight probe merge`: pictures in, a probe and lines out, one line on failure."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import ExifTags, Image

from skylight.cli import main
from skylight.imaging._colour import linear_to_srgb
from skylight.io._files import read_environment_map, write_environment_map
from skylight.sphere._envmap import EnvironmentMap
from tests.cli.test_cli import one_line
from tests.probes.mirror_balls.conftest import (
    FOV_DEG,
    made_light,
    make,
    map_of,
    picture_of,
    true_ball,
)

TIMES = (1 / 64, 1 / 16, 1 / 4)
RESULTS = {"probe.exr", "probe.hdr", "probe.png", "probe.json", "report.png"}


def save_bracket(
    folder: Path, name: str, light: np.ndarray, times: tuple[float, ...] = TIMES
) -> list[str]:
    """sRGB pictures with noise and exposure times in their EXIF data."""
    generator = np.random.default_rng(2)
    paths = []
    for number, time in enumerate(times):
        codes = 255 * linear_to_srgb(torch.from_numpy(np.clip(light * time, 0, 1))).numpy()
        codes = np.rint(codes + 0.5 * generator.standard_normal(codes.shape))
        exif = Image.Exif()
        exif[ExifTags.IFD.Exif] = {ExifTags.Base.ExposureTime: time}
        path = folder / f"{name}{number}.png"
        Image.fromarray(np.clip(codes, 0, 255).astype(np.uint8)).save(path, exif=exif)
        paths.append(str(path))
    return paths


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("merge")


@pytest.fixture(scope="module")
def ball(folder: Path) -> list[str]:
    return save_bracket(folder, "ball", 3 * make().picture)


@pytest.fixture(scope="module")
def circle() -> list[str]:
    return [f"{value:.2f}" for value in true_ball().circle]


def failure(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["probe", "merge", *arguments]) == 2
    return one_line(capsys)


class TestBall:
    def test_one_view(
        self, ball: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        out = tmp_path / "out"
        options = ["--fov-deg", str(FOV_DEG), "--height", "32", "--out", str(out)]
        assert main(["probe", "merge", *ball, *options]) == 0
        assert {path.name for path in out.iterdir()} == RESULTS
        captured = capsys.readouterr()
        assert "64x32 from 3 pictures" in captured.out
        assert "sRGB is taken for the response" in captured.out
        assert "behind the ball, was filled" in captured.err
        told = json.loads((out / "probe.json").read_text())
        assert told["balls"][0]["circle_px"] == pytest.approx(true_ball().circle, abs=1.0)
        assert told["views"][0]["seconds"] == pytest.approx(TIMES, rel=1e-3)
        assert told["turn"] is None
        got = read_environment_map(out / "probe.exr").radiance
        want = 3 * TIMES[-1] * make().radiance  # 1 saturates the longest exposure
        error = ((got - want).abs().mean(-1) / want.mean(-1)).flatten()
        assert float(error.median()) < 0.03

    def test_two_views_and_the_second_ones_own_times(
        self, ball: list[str], circle: list[str], folder: Path, tmp_path: Path
    ) -> None:
        turn = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])  # looks along +X, to the right
        times = (1 / 32, 1 / 8, 1 / 2)
        second = save_bracket(folder, "second", 3 * picture_of(made_light, turn), times)
        where = ["--ball", *circle, "--second-ball", *circle, "--fov-deg", str(FOV_DEG)]
        options = ["--second", *second, *where, "--height", "32", "--out", str(tmp_path)]
        assert main(["probe", "merge", *ball, *options]) == 0
        told = json.loads((tmp_path / "probe.json").read_text())
        assert told["turn"]["azimuth_deg"] == pytest.approx(90, abs=1)
        assert told["turn"]["gain"] == pytest.approx(1, abs=0.02)
        got = read_environment_map(tmp_path / "probe.hdr").radiance
        want = 3 * TIMES[-1] * map_of(made_light, 32)
        error = ((got - want).abs().mean(-1) / want.mean(-1)).flatten()
        assert float(error.median()) < 0.03

    def test_clipped_light_and_a_missing_lens_are_said(
        self, ball: list[str], circle: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        options = ["--ball", *circle, "--height", "32", "--out", str(tmp_path)]
        assert main(["probe", "merge", *ball[1:], *options]) == 0
        captured = capsys.readouterr()
        assert "the shortest exposure is saturated over" in captured.err
        assert "nothing tells the field of view" in captured.err
        assert "two exposures are too few" in captured.out
        told = json.loads((tmp_path / "probe.json").read_text())
        assert told["clipped"]["solid_angle_sr"] > 0
        assert told["fov_deg"] is None


class TestPanorama:
    def test_exposures_of_a_lat_long_picture(self, folder: Path, tmp_path: Path) -> None:
        want = map_of(made_light, 64)
        shots = save_bracket(folder, "pano", 3 * want.numpy())
        options = ["--kind", "360", "--height", "32", "--out", str(tmp_path)]
        assert main(["probe", "merge", *shots, *options]) == 0
        got = read_environment_map(tmp_path / "probe.exr").radiance / (3 * TIMES[-1])
        averaged = EnvironmentMap(radiance=want).resize(32).radiance.float()
        assert float(((got - averaged).abs() / averaged).median()) < 0.01

    def test_a_file_that_was_merged_already(self, tmp_path: Path) -> None:
        light = EnvironmentMap(radiance=map_of(made_light, 32).float())
        write_environment_map(tmp_path / "light.exr", light)
        options = ["--kind", "360", "--height", "32", "--out", str(tmp_path / "out")]
        assert main(["probe", "merge", str(tmp_path / "light.exr"), *options]) == 0
        got = read_environment_map(tmp_path / "out" / "probe.exr").radiance
        torch.testing.assert_close(got, light.radiance)

    def test_no_lat_long_picture(
        self, ball: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        line = failure(capsys, *ball, "--kind", "360", "--out", str(tmp_path / "out"))
        assert "300x240 pixels; a 360-degree picture" in line
        assert not (tmp_path / "out").exists()


class TestRefusals:
    @pytest.mark.parametrize(
        ("options", "message"),
        [
            (["--times", "1,2"], "2 exposure times and 3 pictures"),
            (["--times", "1,1,2"], "too alike"),
            (["--times", "1,x,2"], "must be a list such as"),
            (["--ball", "20", "100", "60"], "reaches 40 px out of the picture"),
            (["--kind", "360", "--ball", "150", "100", "60"], "for --kind ball alone"),
            (["--second-ball", "150", "100", "60"], "give these as well"),
            (["--turn-deg", "3"], "--turn-deg must be"),
            (["--reflectivity", "0"], "--reflectivity must be"),
            (["--height", "4"], "--height must be 16 to 1024"),
            (["--fov-deg", "200"], "field of view"),
            (["--response", "none.json"], "none.json"),
        ],
    )
    def test_options(
        self,
        ball: list[str],
        options: list[str],
        message: str,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        assert message in failure(capsys, *ball, *options, "--out", str(tmp_path / "out"))

    def test_one_picture(
        self, ball: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        line = failure(capsys, ball[0], "--out", str(tmp_path / "out"))
        assert "one picture cannot show both lamps and shadows" in line

    def test_no_times(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        paths = [tmp_path / f"{i}.png" for i in range(2)]
        for path in paths:
            Image.fromarray(np.full((64, 64, 3), 90, np.uint8)).save(path)
        line = failure(capsys, *map(str, paths), "--out", str(tmp_path / "out"))
        assert "tell no exposure time; give --times" in line

    def test_sizes(
        self, ball: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        other = tmp_path / "other.png"
        Image.fromarray(np.full((64, 64, 3), 90, np.uint8)).save(other)
        times = ["--times", "1,2"]
        line = failure(capsys, ball[0], str(other), *times, "--out", str(tmp_path / "out"))
        assert "64x64 pixels, but" in line

    def test_no_ball_in_sight(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        plain = np.random.default_rng(0).uniform(1, 2, (120, 160, 3))
        shots = save_bracket(folder, "plain", plain)
        line = failure(capsys, *shots, "--out", str(tmp_path / "out"))
        assert "give its middle and radius in pixels with --ball" in line
