"""The measure of how far simulated skies are from captured maps (tools/measure_sky_realism.py)."""

import math

import numpy as np
import pytest
import torch

from tools import measure_sky_realism
from tools.measure_sky_realism import NAMES, distances, floor, place, sky_statistics, told_apart

HEIGHT = 32


def statistics(sky: torch.Tensor) -> dict[str, float]:
    return dict(zip(NAMES, sky_statistics(sky[None])[0], strict=True))


def random_sky() -> torch.Tensor:
    generator = torch.Generator().manual_seed(1)
    return torch.exp(torch.randn(HEIGHT, 4 * HEIGHT, 3, generator=generator))


def test_uniform_grey_sky() -> None:
    found = statistics(torch.full((HEIGHT, 4 * HEIGHT, 3), 2.0))
    for name, value in found.items():
        level = math.log(2) if name.startswith("log_luminance_") and "_sd" not in name else 0
        assert value == pytest.approx(level, abs=1e-6), name


def test_blue_gain_of_e() -> None:
    sky = random_sky()
    before = statistics(sky)
    after = statistics(sky * torch.tensor([1, 1, math.e]))
    for name in NAMES:
        if name.startswith("log_blue_green"):
            assert after[name] - before[name] == pytest.approx(1, abs=1e-6)
        elif name.startswith("log_red_green"):
            assert after[name] == pytest.approx(before[name], abs=1e-6)


def test_exposure_only_moves_the_level() -> None:
    sky = random_sky()
    before, after = statistics(sky), statistics(3 * sky)
    for name in NAMES:
        level = math.log(3) if name.startswith("log_luminance_") and "_sd" not in name else 0
        assert after[name] - before[name] == pytest.approx(level, abs=1e-5), name


def test_exponential_fall_along_zenith_angle() -> None:
    """ln Y = -z / 20 deg: |d ln Y / dz| = 0.05 per degree in every band, 0 along the azimuth."""
    zenith_deg = (torch.arange(HEIGHT, dtype=torch.float64) + 0.5) * 90 / HEIGHT
    sky = torch.exp(-zenith_deg / 20).float()[:, None, None].expand(HEIGHT, 4 * HEIGHT, 3)
    for name, value in statistics(sky).items():
        if name.startswith("vertical_gradient"):
            assert value == pytest.approx(0.05, rel=1e-4)
        elif name.startswith("azimuthal_gradient"):
            assert value == pytest.approx(0, abs=1e-6)


def test_alternating_columns() -> None:
    """ln Y = +-1/2 by turns: its standard deviation is 1/2, and 1 lies between neighbours.

    Of an arc sin(z) 360/w degrees; its inverse, averaged over a band by solid angle, is
    w/360 (z2 - z1) / (cos z1 - cos z2).
    """
    sign = torch.tensor([0.5, -0.5]).repeat(2 * HEIGHT)
    found = statistics(torch.exp(sign)[None, :, None].expand(HEIGHT, 4 * HEIGHT, 3))
    low, high = (math.radians(row * 90 / HEIGHT) for row in (21, 28))  # rows within 60 to 80 deg
    mean = (high - low) / (math.cos(low) - math.cos(high))
    assert found["azimuthal_gradient_60_80"] == pytest.approx(4 * HEIGHT / 360 * mean, rel=1e-3)
    for name, value in found.items():
        if "_sd_" in name:
            assert value == pytest.approx(0.5, rel=1e-5)
        elif name.startswith("vertical_gradient"):
            assert value == pytest.approx(0, abs=1e-6)


def test_distance_to_itself_and_to_a_shifted_copy() -> None:
    a = np.random.default_rng(0).normal(size=(30, 2))
    assert distances(a, a[::-1]) == pytest.approx([0, 0])
    assert distances(a, a + np.array([0.5, -2])) == pytest.approx([0.5, 2])


def test_floor_keeps_a_place_in_one_half() -> None:
    """Two places, each always the same: the halves are one place each."""
    real = np.array([[0.0], [0.0], [3.0], [3.0]])
    assert floor(real, ["a", "a", "b", "b"]) == pytest.approx([3])


def test_one_place_for_maps_of_one_place() -> None:
    assert place("aristea_wreck") == place("aristea_wreck_puresky")
    assert place("pmndrs_venice") == place("venice_sunset")
    assert place("quarry_01") != place("skidpan")


@pytest.mark.parametrize(("apart", "low", "high"), [(4.0, 0.97, 1.0), (0.0, 0.35, 0.65)])
def test_classifiers_know_what_differs_and_nothing_else(
    apart: float, low: float, high: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By one cross-validation; chance moves an area under the curve by 0.05 of 40 and 100 skies."""
    monkeypatch.setattr(measure_sky_realism, "REPEATS", 1)
    rng = np.random.default_rng(0)
    real, simulated = rng.normal(size=(40, 4)) + apart, rng.normal(size=(100, 4))
    found = told_apart(real, simulated, [str(i) for i in range(len(real))])
    for scores in found.values():
        assert low <= scores["roc_auc"] <= high
        assert low <= scores["balanced_accuracy"] <= high
