"""Lamps taken out of an estimate's map: what is left, and how wide and which way they are."""

import math

import pytest
import torch

from skylight.errors import InputError
from skylight.models._lobes import WIDTH_BOUNDS_RAD
from skylight.relight._lamps import (
    MOST_CLAMPED,
    colour_and_strength,
    disc_diameter_rad,
    quaternion_towards,
    without_lamps,
)
from skylight.sphere._frame import DirectionGrid
from tests.lamp_lit import ambient_of, lamp_lit, lamp_params

# log widths at both bounds, three lamps, one at the zenith and one straight ahead
EXTREME = lamp_params(
    ((0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (0.6, -0.5, 0.6)),
    ((2.0, -2.0, 0.0, 0.5), (0.5, 3.0, 1.0, 0.0), (-1.0, 0.0, 0.0, 0.0)),
)


@pytest.mark.parametrize("params", [lamp_params(), EXTREME], ids=["usual", "extreme"])
def test_what_is_left_is_the_ambient_light(params: torch.Tensor) -> None:
    light, lamps = lamp_lit(params)
    rest, ambient = without_lamps(light, lamps), ambient_of(params)
    assert rest.radiance.dtype == light.radiance.dtype
    assert float(rest.radiance.min()) >= 0
    off = (rest.flat.double() - ambient.flat).abs().sum(1) @ light.grid.solid_angles
    held = (light.flat.double() - ambient.flat).sum(1) @ light.grid.solid_angles
    assert float(off) < 0.1 * MOST_CLAMPED * float(held)


@pytest.mark.parametrize("params", [lamp_params(), EXTREME], ids=["usual", "extreme"])
def test_a_surface_that_faces_a_lamp_receives_what_it_did(params: torch.Tensor) -> None:
    light, lamps = lamp_lit(params)
    for lamp in lamps:
        # of this lamp alone: the others are seen at a slant
        rest = without_lamps(light, [lamp])
        found = rest.irradiance(lamp.direction) + lamp.irradiance
        torch.testing.assert_close(found, light.irradiance(lamp.direction), rtol=0.005, atol=0)


def test_a_map_without_the_lamps_is_refused() -> None:
    light, lamps = lamp_lit(lamp_params())
    for other in (without_lamps(light, lamps), light.rotate_azimuth(0.1)):
        with pytest.raises(InputError, match="does not hold the light of the estimate's lamps"):
            without_lamps(other, lamps)


@pytest.mark.parametrize(
    ("spread_deg", "off"), [(3.0, 0.003), (8.0, 0.006), (20.0, 0.015), (40.0, 0.08)]
)
def test_a_disc_as_wide_lights_all_surfaces_as_the_lobe_does(spread_deg: float, off: float) -> None:
    """Sums over a million directions about +Y; what surfaces receive that do not face it, too."""
    spread = math.radians(spread_deg)
    radius = disc_diameter_rad(spread) / 2
    grid = DirectionGrid.latlong(720)
    cosine = grid.directions[:, 1]
    lobe = torch.exp((cosine - 1) / spread**2) * grid.solid_angles
    disc = (cosine > math.cos(radius)) * grid.solid_angles
    assert float((disc / disc.sum()) @ cosine) == pytest.approx(
        float((lobe / lobe.sum()) @ cosine), abs=0.002
    )
    for tilt_deg in (0, 30, 60, 75, 90, 105):
        normal = torch.tensor([math.sin(math.radians(tilt_deg)), math.cos(math.radians(tilt_deg))])
        facing = (grid.directions[:, :2] @ normal.double()).clamp(min=0)
        above = cosine.clamp(min=0)
        # lights of the same irradiance where surfaces face them
        by_lobe, by_disc = (float(w @ facing) / float(w @ above) for w in (lobe, disc))
        assert by_disc == pytest.approx(by_lobe, abs=off)


def test_narrow_lamps_are_four_spreads_wide_and_the_widest_half_a_sphere_at_most() -> None:
    assert disc_diameter_rad(1e-3) == pytest.approx(4e-3, rel=1e-4)
    assert disc_diameter_rad(WIDTH_BOUNDS_RAD[1]) < math.pi


def test_quaternions_turn_z_to_the_lamp() -> None:
    generator = torch.Generator().manual_seed(1)
    drawn = torch.randn(20, 3, generator=generator, dtype=torch.float64)
    beside = torch.tensor([[1e-4, 0.0, -1.0]], dtype=torch.float64)
    axes = torch.eye(3, dtype=torch.float64)
    for direction in torch.nn.functional.normalize(torch.cat([drawn, beside, axes, -axes])):
        x, y, z, w = quaternion_towards(direction)
        assert math.hypot(x, y, z, w) == pytest.approx(1)
        # third column of the rotation matrix
        turned = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
        assert turned == pytest.approx(direction.tolist(), abs=1e-7)


def test_colours_are_of_one_at_most_and_a_black_lamp_is_white_of_no_strength() -> None:
    assert colour_and_strength(torch.tensor([1.0, 4.0, 2.0])) == ([0.25, 1.0, 0.5], 4.0)
    assert colour_and_strength(torch.zeros(3)) == ([1.0, 1.0, 1.0], 0.0)
