import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st
from skimage.metrics import structural_similarity

from skylight.errors import InputError
from skylight.imaging._colour import linear_to_srgb
from skylight.imaging._metrics import (
    full_dw_mae,
    lighting_metrics,
    mae,
    rmse,
    shading_metrics,
    si_rmse,
    sky_dw_mae,
    ssim,
    sun_angle_deg,
    sun_dw_mae,
    sun_dw_mae_fixed,
    sun_region,
)
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, angle_between, direction_from_angles


def constant(value: float, height: int = 32) -> EnvironmentMap:
    return EnvironmentMap(radiance=torch.full((height, 2 * height, 3), value))


def sun_and_sky(
    azimuth_deg: float, elevation_deg: float, *, sun: float = 1000.0, height: int = 128
) -> EnvironmentMap:
    """A disc of 3 degrees' radius on a uniform sky of 1, above black ground.

    Pixels are averages over 4 x 4 points: with one point each, the disc's own centroid would be
    off by up to a degree on 2.8-degree pixels.
    """
    fine = 4 * height
    grid = DirectionGrid.latlong(fine)
    angles = torch.tensor([azimuth_deg, 90 - elevation_deg], dtype=torch.float64).deg2rad()
    towards = direction_from_angles(angles[0], angles[1])
    in_disc = angle_between(grid.directions, towards) < math.radians(3)
    radiance = torch.where(in_disc, sun, 1.0) * (grid.directions[:, 1] > 0)
    radiance = radiance[:, None].expand(-1, 3).reshape(fine, 2 * fine, 3)
    return EnvironmentMap(radiance=radiance.float()).resize(height)


def one_pixel_sun(strength: float) -> EnvironmentMap:
    """A sun on one pixel of 2.8 degrees, 32 degrees high, in a uniform sky of 1."""
    radiance = torch.ones(64, 128, 3)
    radiance[32:] = 0
    radiance[20, 40] = strength
    return EnvironmentMap(radiance=radiance)


def picture(seed: int = 0, height: int = 40, width: int = 50) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(height, width, 3, generator=generator) + 0.1


# ---- shading


def test_equal_pictures_score_perfectly() -> None:
    image = picture()
    mask = torch.zeros(40, 50, dtype=torch.bool)
    mask[5:30, 10:40] = True
    assert shading_metrics(image, image, mask) == pytest.approx(
        {"mae": 0, "rmse": 0, "si_rmse": 0, "ssim": 1}, abs=1e-9
    )


def test_shading_errors_of_constant_pictures() -> None:
    true = torch.full((12, 12, 3), 2.0)
    assert mae(1.5 * true, true) == pytest.approx(0.5)
    assert rmse(0.25 * true, true) == pytest.approx(0.75)
    assert si_rmse(0.25 * true, true) == pytest.approx(0, abs=1e-7)
    assert si_rmse(0 * true, true) == pytest.approx(1)


def test_shading_errors_by_hand() -> None:
    true = torch.tensor([[1.0, 1.0, 1.0], [3.0, 3.0, 3.0]])  # mean 2
    pred = torch.tensor([[1.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
    assert mae(pred, true) == pytest.approx(0.5)
    assert rmse(pred, true) == pytest.approx(math.sqrt(2) / 2)
    assert si_rmse(pred, true) == pytest.approx(0.5)  # best scale 2: errors of 1 over a mean of 2


@given(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3))
def test_exposure_of_both_does_not_matter_and_si_rmse_forgives_either(a: float, b: float) -> None:
    pred, true = picture(1), picture(2)
    assert mae(a * pred, a * true) == pytest.approx(mae(pred, true), rel=1e-5)
    assert rmse(a * pred, a * true) == pytest.approx(rmse(pred, true), rel=1e-5)
    assert si_rmse(a * pred, b * true) == pytest.approx(si_rmse(pred, true), rel=1e-5)
    assert si_rmse(pred, true) <= rmse(pred, true)


def test_only_the_mask_counts() -> None:
    true, pred = picture(), picture()
    mask = torch.ones(40, 50, dtype=torch.bool)
    mask[:10] = False
    pred[:10] = 50.0
    assert shading_metrics(pred, true, mask)["ssim"] == pytest.approx(1)
    assert shading_metrics(pred, true, mask)["rmse"] == 0
    assert shading_metrics(pred, true)["rmse"] > 1


@pytest.mark.parametrize("share", [None, 0.5])  # of the quantile that is white by default
def test_ssim_is_scikit_images(share: float | None) -> None:
    pred, true = picture(1), picture(2)
    luminances = (true @ torch.tensor([0.2126, 0.7152, 0.0722])).flatten().sort().values
    white = float(luminances[round(0.98 * (len(luminances) - 1))]) * (share or 1)
    shown = [linear_to_srgb((x / white).clamp(0, 1)).numpy() for x in (pred, true)]
    _, want = structural_similarity(
        *shown,
        channel_axis=-1,
        data_range=1.0,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        full=True,
    )
    score = ssim(pred, true, white=None if share is None else white)
    assert score == pytest.approx(np.mean(want), abs=5e-3)  # borders are padded differently
    assert score < 0.2


def test_black_truth_and_empty_mask_are_refused() -> None:
    black = torch.zeros(12, 12, 3)
    with pytest.raises(InputError, match="black"):
        mae(black, black)
    for score in (full_dw_mae, sun_dw_mae):
        with pytest.raises(InputError, match="black"):
            score(constant(1.0), constant(0.0))
    with pytest.raises(InputError, match="mask"):
        shading_metrics(black, black, torch.zeros(12, 12, dtype=torch.bool))
    with pytest.raises(InputError, match="resize"):
        full_dw_mae(constant(1.0, 16), constant(1.0, 32))


# ---- lighting


def test_equal_probes_score_zero() -> None:
    light = sun_and_sky(40, 35)
    assert lighting_metrics(light, light) == dict.fromkeys(lighting_metrics(light, light), 0.0)


def test_constant_probes() -> None:
    assert full_dw_mae(constant(3.0), constant(2.0)) == pytest.approx(0, abs=1e-7)
    assert full_dw_mae(constant(3.0), constant(2.0), align_scale=False) == pytest.approx(0.5)
    for align in (True, False):
        assert full_dw_mae(constant(0.0), constant(2.0), align_scale=align) == pytest.approx(1)


def test_disjoint_probes_are_two_apart() -> None:
    true = torch.zeros(16, 32, 3)
    pred = true.clone()
    true[2, 3], pred[9, 20] = 5.0, 1.0
    got = full_dw_mae(EnvironmentMap(radiance=pred), EnvironmentMap(radiance=true))
    assert got == pytest.approx(2)


def test_a_wrong_colour_counts() -> None:
    true, pred = torch.zeros(16, 32, 3), torch.zeros(16, 32, 3)
    true[..., 0], pred[..., 2] = 1.0, 1.0
    got = full_dw_mae(EnvironmentMap(radiance=pred), EnvironmentMap(radiance=true))
    assert got == pytest.approx(2)


@pytest.mark.parametrize("elevation_deg", [20.0, 45.0, 80.0])
def test_the_suns_region_is_a_cap_of_13_degrees(elevation_deg: float) -> None:
    light = sun_and_sky(-70, elevation_deg)
    area = float(light.grid.solid_angles[sun_region(light)].sum())
    assert area == pytest.approx(2 * math.pi * (1 - math.cos(math.radians(13))), rel=0.02)


def test_the_suns_region_ends_at_the_horizon() -> None:
    light = sun_and_sky(10, 2.9)
    area = float(light.grid.solid_angles[sun_region(light)].sum())
    cap = 2 * math.pi * (1 - math.cos(math.radians(13)))
    assert 0.5 * cap < area < 0.8 * cap


def test_sky_and_sun_and_ground_make_the_whole() -> None:
    true, pred = sun_and_sky(40, 35), sun_and_sky(60, 30)
    scores = lighting_metrics(pred, true)
    # both have black ground, so the two regions hold the whole error
    parts = scores["sky_dw_mae"] + scores["sun_dw_mae_fixed"]
    assert parts == pytest.approx(scores["full_dw_mae"])


def test_a_missing_sun_shows_in_the_sun_score_alone() -> None:
    true, pred = sun_and_sky(40, 35), sun_and_sky(40, 35, sun=1.0)
    disc = 2 * math.pi * (1 - math.cos(math.radians(3)))
    share = 999 * disc / (2 * math.pi + 999 * disc)
    for score in (sun_dw_mae, sun_dw_mae_fixed):
        assert score(pred, true, align_scale=False) == pytest.approx(share, rel=0.03)
    assert sky_dw_mae(pred, true, align_scale=False) == pytest.approx(0, abs=1e-7)


def test_the_ground_is_no_sky() -> None:
    """Half of all light moved to below the horizon, where the truth has none."""
    true = sun_and_sky(40, 35)
    radiance = true.radiance.clone()
    radiance[64:] = 3.0
    pred = EnvironmentMap(radiance=radiance)
    assert full_dw_mae(pred, true, align_scale=False) > 0.5
    assert sky_dw_mae(pred, true, align_scale=False) == pytest.approx(0, abs=1e-9)
    assert sun_dw_mae_fixed(pred, true, align_scale=False) == pytest.approx(0, abs=1e-9)


def test_the_white_is_the_quantile_and_not_the_brightest() -> None:
    """A lamp in one pixel of a hundred changes what is shown of no other."""
    true = torch.full((40, 50, 3), 0.5)
    true[:, ::2] = 1.0
    pred = true.clone()
    pred[:, 1::2] = 0.4
    plain = ssim(pred, true)
    for picture_ in (pred, true):
        picture_[::10, ::10] = 1e4
    assert ssim(pred, true) == pytest.approx(plain)
    assert plain < 0.98
    assert ssim(pred, true, white=1e4) > 0.99  # all but the lamps is black in both


@pytest.mark.parametrize("elevation_deg", [20.0, 35.0, 50.0])
def test_a_sun_elsewhere_is_the_same_sun(elevation_deg: float) -> None:
    true = sun_and_sky(40, elevation_deg)
    pred = true.rotate_azimuth(math.radians(20))
    # 20 degrees are 14.2 columns: the turn blurs the disc's edge across the ring at 4 degrees
    assert sun_dw_mae(pred, true) < 0.05
    assert sun_dw_mae_fixed(pred, true) > 0.5


@pytest.mark.parametrize("part", [0.25, 0.5, 0.75])
def test_a_sun_between_two_pixels_is_the_same_sun(part: float) -> None:
    true, pred = one_pixel_sun(1000.0), one_pixel_sun(400.0)
    moved = pred.rotate_azimuth(part * 2 * math.pi / 128)
    # within 0.01 of the probe's sum: pixels of the sky on a cell's border change cells
    assert sun_dw_mae(moved, true) == pytest.approx(sun_dw_mae(pred, true), abs=0.01)
    assert abs(sun_dw_mae_fixed(moved, true) - sun_dw_mae_fixed(pred, true)) > 0.04


@settings(max_examples=30)
@given(st.floats(0, 359), st.floats(15, 75), st.floats(-60, 60))
def test_sun_angle(azimuth_deg: float, elevation_deg: float, turn_deg: float) -> None:
    true = sun_and_sky(azimuth_deg, elevation_deg, height=64)
    pred = true.rotate_azimuth(math.radians(turn_deg))
    chord = math.cos(math.radians(elevation_deg)) * math.sin(math.radians(abs(turn_deg) / 2))
    two_half_pixels = 180 / 64  # either sun is found within half a pixel
    found, expected = sun_angle_deg(pred, true), 2 * math.degrees(math.asin(chord))
    assert found == pytest.approx(expected, abs=two_half_pixels)


def test_scores_of_a_sky_map_use_the_sky_alone() -> None:
    full = sun_and_sky(40, 35)
    pred = sun_and_sky(60, 30)
    assert lighting_metrics(pred.upper(), full.upper()) == pytest.approx(
        lighting_metrics(pred, full), abs=1e-6
    )
