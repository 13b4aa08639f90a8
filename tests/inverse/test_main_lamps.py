"""Lamps of maps made of discs of known energy on constant light."""

import math

import pytest
import torch

from skylight.inverse._scores import find_lamps
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, angle_between
from tests.sunny_face import direction as at

BACKGROUND = 0.2
Disc = tuple[float, float, float, float]  # azimuth, zenith, radius in degrees; radiance


def room(*discs: Disc, height: int = 512) -> EnvironmentMap:
    """Discs sampled finely and averaged to 64 rows: their borders are partly covered pixels."""
    grid = DirectionGrid.latlong(height)
    light = torch.full((len(grid.directions),), BACKGROUND)
    for azimuth, zenith, radius, radiance in discs:
        inside = grid.directions @ at(azimuth, zenith) > math.cos(math.radians(radius))
        light[inside] = radiance
    radiance = light.reshape(height, -1, 1).expand(-1, -1, 3).contiguous()
    return EnvironmentMap(radiance=radiance).resize(64)


def excess(disc: Disc) -> float:
    """(L - b) 2 pi (1 - cos r)"""
    return (disc[3] - BACKGROUND) * 2 * math.pi * (1 - math.cos(math.radians(disc[2])))


# beside the pole; on the seam and below the horizon; three in a row, 35 degrees apart
ROOMS: list[list[Disc]] = [
    [(40.0, 12.0, 8.0, 60.0), (-179.0, 100.0, 5.0, 90.0)],
    [(0.0, 60.0, 3.0, 500.0), (35.0, 90.0, 10.0, 25.0), (70.0, 90.0, 10.0, 15.0)],
]


@pytest.mark.parametrize("discs", ROOMS)
def test_discs_are_found_where_they_are_with_their_share(discs: list[Disc]) -> None:
    total = 4 * math.pi * BACKGROUND + sum(map(excess, discs))
    found = find_lamps(room(*discs))
    assert len(found) == len(discs)
    wanted = sorted(discs, key=excess, reverse=True)
    for lamp, disc in zip(found, wanted, strict=True):
        assert lamp.share == pytest.approx(excess(disc) / total, rel=0.03)
        apart = float(angle_between(lamp.direction, at(*disc[:2])))
        assert math.degrees(apart) < 0.5


def test_small_lamps_and_more_than_are_asked_for_are_left_out() -> None:
    discs = ROOMS[1]
    shares = [lamp.share for lamp in find_lamps(room(*discs))]
    assert len(find_lamps(room(*discs), least_share=shares[1])) == 1
    (main,) = find_lamps(room(*discs), most=1)
    assert main.share == shares[0]


def test_lamps_turn_with_the_map_and_do_not_depend_on_exposure_and_size() -> None:
    light = room(*ROOMS[0])
    turned = EnvironmentMap(radiance=7 * light.rotate_azimuth(math.radians(90)).radiance)
    for before, after in zip(find_lamps(light), find_lamps(turned), strict=True):
        x, y, z = before.direction  # a quarter turn to the right: -Z goes to +X
        expected = torch.stack([-z, y, x])
        assert math.degrees(float(angle_between(after.direction, expected))) < 0.1
        assert after.share == pytest.approx(before.share, rel=1e-3)
    larger = find_lamps(room(*ROOMS[0], height=128))
    assert larger[0].share == pytest.approx(find_lamps(light)[0].share, rel=0.1)


@pytest.mark.parametrize("level", [0.0, 3.0])
def test_constant_light_has_no_lamps(level: float) -> None:
    constant = EnvironmentMap(radiance=torch.full((64, 128, 3), level))
    assert find_lamps(constant, least_share=0.0) == []
