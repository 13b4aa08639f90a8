"""Suns that saturate the shortest exposure are said, with their solid angle."""

import math

import numpy as np
import pytest
import torch

from skylight.probes._probe_map import ProbeMap
from skylight.probes.cameras._exposures import SUN_SR, find_clipping
from skylight.probes.mirror_balls._merged import unwrap
from skylight.sphere._envmap import EnvironmentMap
from tests.probes.mirror_balls.conftest import made_light, picture_of, view_of

RADIUS = math.radians(6.0)
SUN = np.array([0.6, 0.5, 0.62]) / np.linalg.norm([0.6, 0.5, 0.62])


def with_sun(w: np.ndarray) -> np.ndarray:
    colour = made_light(w)
    colour[w @ SUN > math.cos(RADIUS)] = 500.0
    return colour


def even(clipped: torch.Tensor) -> ProbeMap:
    """Light of 1 from all directions, with these shares of clipped light."""
    light = EnvironmentMap(radiance=torch.ones(8, 16, 3))
    return ProbeMap(environment=light, clipped=clipped, seen=torch.ones(8, 16))


def test_the_suns_disc() -> None:
    assert pytest.approx(6.8e-5, rel=0.01) == SUN_SR


def test_a_clipped_disc_in_a_ball() -> None:
    picture = picture_of(with_sun)
    clipped = picture.max(-1) >= 50
    probe = unwrap(view_of(np.minimum(picture, 50), clipped), 64)
    found = find_clipping(probe)
    assert found is not None
    # pixels partly of the sun saturate as well
    true = 2 * math.pi * (1 - math.cos(RADIUS))
    assert true < found.solid_angle_sr < 1.5 * true
    assert found.regions == 1
    zenith = math.degrees(math.acos(SUN[1]))
    azimuth = math.degrees(math.atan2(SUN[0], -SUN[2]))
    assert (found.azimuth_deg, found.zenith_deg) == pytest.approx((azimuth, zenith), abs=1.0)
    # every channel is counted with 50, the level of saturation
    assert min(found.radiance_sr) > 50 * true
    assert 0 < found.light_share < 1
    assert f"azimuth {azimuth:.0f}" in found.sentence()


def test_regions_join_across_the_edge_of_the_map() -> None:
    share = torch.zeros(8, 16)
    share[3, [0, 15]] = 1
    share[6, 4:6] = 0.5
    probe = even(share)
    found = find_clipping(probe)
    assert found is not None
    assert found.regions == 2
    assert abs(found.azimuth_deg) == pytest.approx(180, abs=1e-6)
    angles = probe.environment.grid.solid_angles.reshape(8, 16)
    want = float((share.double() * angles).sum())
    assert found.solid_angle_sr == pytest.approx(want)
    assert found.light_share == pytest.approx(want / (4 * math.pi))


def test_pixels_at_a_pole_are_one_region() -> None:
    """Opposite ones in the first row meet at the zenith; so do three in the last, at the nadir."""
    share = torch.zeros(8, 16)
    share[0, [2, 10]] = 1
    share[1, 2] = 1
    share[7, [0, 5, 11]] = 0.1
    probe = even(share)
    found = find_clipping(probe)
    assert found is not None
    assert found.regions == 2
    # the sum of the three pixels' directions; rows' middles are 11.25 and 33.75 degrees from +Y
    sizes = probe.environment.grid.solid_angles.reshape(8, 16)[:, 0].tolist()
    low, high = math.radians(11.25), math.radians(33.75)
    aside = sizes[1] * math.sin(high)
    up = 2 * sizes[0] * math.cos(low) + sizes[1] * math.cos(high)
    assert found.zenith_deg == pytest.approx(math.degrees(math.atan2(aside, up)), abs=1e-4)


def test_nothing_clipped() -> None:
    assert find_clipping(even(torch.zeros(8, 16))) is None
