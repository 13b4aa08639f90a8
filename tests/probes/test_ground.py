"""The ground's albedo in drawn photos of a chart that lies on it, through a lens that darkens."""

import json
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from skylight.cli import main
from skylight.errors import InputError
from skylight.imaging._colour import linear_to_srgb
from skylight.models._ground import KnownGround
from skylight.probes._chart import GREYS, GreyLine, MeasuredGround, flat_field, measure_ground
from skylight.probes.cameras._response import Response, saturated
from tests.drawn_chart import grey_albedos, lay_chart

GRASS = np.array([0.09, 0.10, 0.03])  # thesis, Fig. B.4
SUN = np.array([0.95, 0.9, 0.8])
SIZE = (450, 650)
CHART = [[60, 45], [350, 35], [360, 235], [55, 240]]


def vignetting() -> np.ndarray:
    """cos^4 of a wide lens, whose axis misses the middle of the picture."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    r2 = ((x - 375) ** 2 + (y - 200) ** 2) / 500.0**2
    return (1 / (1 + r2) ** 2)[..., None]


@cache
def photo(
    *, dark_corners: bool = True, brightness: float = 1.0, level: float = 1.0, new: bool = False
) -> np.ndarray:
    """Codes in sRGB: grass whose tufts vary by a third, the chart on it, a pixel's noise."""
    rng = np.random.default_rng(1)
    tufts = cv2.GaussianBlur(rng.standard_normal(SIZE).astype(np.float32), (0, 0), 3)
    tufts = 0.33 * tufts / tufts.std()
    scene = (GRASS * np.exp(tufts - tufts.var() / 2)[..., None]).astype(np.float32)
    scene *= GRASS / scene.mean((0, 1))
    lay_chart(scene, CHART, new=new)
    light = level * scene * SUN * brightness * (vignetting() if dark_corners else 1)
    return noisy(light, rng)


@cache
def flat() -> np.ndarray:
    """An overcast sky, of another colour and brightness, through the same lens."""
    rng = np.random.default_rng(2)
    return noisy(np.array([0.5, 0.6, 0.7]) * vignetting(), rng)


def noisy(light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    codes = 255 * linear_to_srgb(torch.from_numpy(light)).numpy()
    codes += rng.standard_normal(light.shape)
    return np.clip(np.rint(codes), 0, 255).astype(np.uint8)


def measured(codes: np.ndarray, *, even: bool = True, **options: object) -> MeasuredGround:
    light, gain = Response().linearise(codes).numpy(), None
    if even:
        gain = flat_field(Response().linearise(flat()).numpy(), saturated(flat()))
    return measure_ground(codes, light, saturated(codes), gain=gain, **options)  # type: ignore[arg-type]


def test_grass_is_told_through_a_lens_that_darkens() -> None:
    found = measured(photo())
    np.testing.assert_allclose(found.rgb, GRASS, rtol=0.04)
    assert (np.abs(found.rgb - GRASS) < 4 * found.error).all()
    assert (found.error < 0.05 * GRASS + 0.002).all()
    # all but the chart and what is round it
    assert 0.6 < found.share < 0.8


def test_greys_are_those_that_were_published() -> None:
    np.testing.assert_allclose(GREYS, grey_albedos()[1:], atol=6e-5)


def test_newer_charts_tell_the_same_to_a_fortieth() -> None:
    """Exactly, without a picture's noise; by white too it would be a fifth."""
    line = GreyLine.through(grey_albedos(new=True)[1:], np.ones(5, bool))
    for albedo in (GRASS, np.full(3, 0.05), np.full(3, 0.8)):
        found, _ = line.albedo(albedo, np.zeros(3))
        np.testing.assert_allclose(found, albedo, rtol=0.025)
    np.testing.assert_allclose(measured(photo(new=True)).rgb, GRASS, rtol=0.06)


def test_without_a_flat_field_it_comes_out_too_dark() -> None:
    """The ground lies farther from the axis than the chart: by a fifth of its light."""
    found = measured(photo(), even=False)
    assert (found.rgb < 0.93 * GRASS).all()
    lit_evenly = measured(photo(dark_corners=False), even=False)
    np.testing.assert_allclose(lit_evenly.rgb, GRASS, rtol=0.04)


def test_the_flat_field_is_the_lens() -> None:
    gain = flat_field(Response().linearise(flat()).numpy(), saturated(flat()))
    true = np.broadcast_to(vignetting(), gain.shape)
    # smoothing rounds the maximum and the corners
    np.testing.assert_allclose(gain, true / true.max(), rtol=0.03)


def test_a_region() -> None:
    found = measured(photo(), region=(375, 50, 250, 350))
    assert found.share == pytest.approx(250 * 350 / (450 * 650), rel=0.1)
    np.testing.assert_allclose(found.rgb, GRASS, rtol=0.06)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"region": (500, 0, 250, 50)}, "leaves the photo"),
        ({"region": (0, 0, 25, 25)}, "hardly any ground"),
        ({"region": (100, 75, 150, 100)}, "hardly any ground"),
    ],
)
def test_regions_that_cannot_be(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        measured(photo(), **options)


def test_what_cannot_be_measured() -> None:
    with pytest.raises(InputError, match="no ColorChecker in the photo"):
        measured(np.full((*SIZE, 3), 90, np.uint8))
    with pytest.raises(InputError, match="greys are over-exposed"):
        measured(photo(level=4.0, dark_corners=False), even=False)
    codes, other = photo(), np.ones((40, 50, 3), np.float32)
    light = Response().linearise(codes).numpy()
    with pytest.raises(InputError, match="the flat field has 50x40 pixels"):
        measure_ground(codes, light, saturated(codes), gain=other)


def test_flat_fields_that_are_none() -> None:
    shape = (80, 100, 3)
    clear = np.zeros(shape[:2], bool)
    with pytest.raises(InputError, match="over-exposed"):
        flat_field(np.ones(shape, np.float32), ~clear)
    with pytest.raises(InputError, match="is black"):
        flat_field(np.zeros(shape, np.float32), clear)
    half = np.ones(shape, np.float32)
    half[:40] = 0.01
    with pytest.raises(InputError, match="not even"):
        flat_field(half, clear)


class TestCommand:
    def test_a_file_that_estimates_take(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        Image.fromarray(photo()).save(tmp_path / "chart.png")
        Image.fromarray(flat()).save(tmp_path / "flat.png")
        out = tmp_path / "ground.json"
        options = ["--flat", str(tmp_path / "flat.png"), "--out", str(out)]
        assert main(["probe", "ground", str(tmp_path / "chart.png"), *options]) == 0
        told = capsys.readouterr().out
        known = KnownGround.parse(str(out))
        np.testing.assert_allclose(known.albedo, GRASS, rtol=0.04)
        assert 0.1 < known.spread < 0.15
        assert f"--ground-albedo {known.option()}" in told
        assert json.loads(out.read_text())["standard_error"][0] > 0

    def test_one_line_on_failure(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        Image.fromarray(flat()).save(tmp_path / "flat.png")
        out = tmp_path / "ground.json"
        assert main(["probe", "ground", str(tmp_path / "flat.png"), "--out", str(out)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "no ColorChecker in the photo" in line
        assert not out.exists()
        assert main(["probe", "ground", str(tmp_path / "flat.png"), "--out", "a.txt"]) == 2
        assert "written as .json" in capsys.readouterr().err
