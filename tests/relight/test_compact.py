"""Compact lights of any map: found where they were put, and nothing counted twice."""

import math

import pytest
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.places._simulated import simulate_place
from skylight.relight._compact import CompactLights, compact_lights
from skylight.relight._lamps import disc_diameter_rad
from skylight.skies._sun import SUN_RADIUS_RAD
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid, angle_between, direction_from_angles

SUN_COLOUR = torch.tensor([1.0, 0.9, 0.7], dtype=torch.float64)
NORMALS = DirectionGrid.hammersley(80).directions


def disc(
    height: int, towards: Float[Tensor, "3"], radius_rad: float, energy: float, fine: int = 8
) -> Float[Tensor, "h w 3"]:
    """A uniform disc of light, each pixel the mean of ``fine``^2 directions."""
    grid = DirectionGrid.latlong(fine * height)
    inside = (angle_between(grid.directions, towards) < radius_rad).double()
    inside /= grid.solid_angles @ inside
    shares = EnvironmentMap(radiance=(energy * inside[:, None] * SUN_COLOUR).reshape(
        fine * height, 2 * fine * height, 3
    ))  # fmt: skip
    return shares.resize(height).radiance


def smooth_sky(height: int) -> Float[Tensor, "h w 3"]:
    _, y, z = DirectionGrid.latlong(height).directions.unbind(1)
    sky = torch.stack([1.2 + 0.5 * y, 1.4 + 0.6 * y, 1.8 + 0.7 * y + 0.1 * z], 1)
    return torch.where(y[:, None] > 0, sky, 0.4 * sky).reshape(height, 2 * height, 3)


def worst_error(light: EnvironmentMap, found: CompactLights) -> float:
    """Of the irradiance of surfaces at any slant, over the largest."""
    before = torch.stack([light.irradiance(normal) for normal in NORMALS]).double()
    after = torch.stack([found.rest.irradiance(normal) for normal in NORMALS]).double()
    for lamp in found.lamps:
        after += (NORMALS @ lamp.direction).clamp(min=0)[:, None] * lamp.irradiance
    return float((after - before).abs().max() / before.max())


@pytest.mark.parametrize("height", [128, 256])
@pytest.mark.parametrize(
    ("azimuth_deg", "zenith_deg"),
    [(50, 35), (-179.9, 60), (0, 2), (120, 0.5), (-77, 87)],  # seam, pole and horizon too
)
def test_a_sun_is_found_and_leaves_the_map(
    height: int, azimuth_deg: float, zenith_deg: float
) -> None:
    towards = direction_from_angles(*torch.tensor([azimuth_deg, zenith_deg]).deg2rad().double())
    sky = smooth_sky(height)
    sun = disc(height, towards, float(SUN_RADIUS_RAD), 8.0)
    light = EnvironmentMap(radiance=(sky + sun).float())
    found = compact_lights(light, 3)
    (lamp,) = found.lamps
    # what lies within one pixel has lost its place in it
    assert float(angle_between(lamp.direction, towards)) < 0.75 * math.pi / height
    torch.testing.assert_close(lamp.irradiance, 8 * SUN_COLOUR, rtol=0.02, atol=0)
    assert worst_error(light, found) < 0.005
    assert float((found.rest.radiance.double() - sky).abs().max()) < 0.7  # no sun: it is 1e4
    assert disc_diameter_rad(lamp.spread_rad) == pytest.approx(2 * SUN_RADIUS_RAD, rel=1e-3)
    assert not found.cut_off


@pytest.mark.parametrize("radius_deg", [3.0, 8.0, 14.0])
def test_a_lamps_width_is_told(radius_deg: float) -> None:
    towards = direction_from_angles(*torch.tensor([-30.0, 70.0]).deg2rad().double())
    lit = smooth_sky(128) + disc(128, towards, math.radians(radius_deg), 12.0, fine=4)
    light = EnvironmentMap(radiance=lit.float())
    (lamp,) = (found := compact_lights(light, 1)).lamps
    assert math.degrees(disc_diameter_rad(lamp.spread_rad)) == pytest.approx(
        2 * radius_deg, rel=0.05
    )
    assert math.degrees(float(angle_between(lamp.direction, towards))) < 0.2
    # a surface that sees half of the disc: 2 a / (3 pi) of what faces it
    assert worst_error(light, found) < 2 * math.radians(radius_deg) / (3 * math.pi)


def test_the_strongest_come_first_and_only_so_many() -> None:
    ways = [
        direction_from_angles(*torch.tensor(angles).deg2rad().double())
        for angles in ([20.0, 50.0], [140.0, 80.0], [-100.0, 100.0])
    ]
    lit = smooth_sky(128)
    for way, energy in zip(ways, (4.0, 9.0, 6.0), strict=True):
        lit += disc(128, way, math.radians(2), energy, fine=4)
    light = EnvironmentMap(radiance=lit.float())
    lamps = compact_lights(light, 8).lamps
    assert [round(float(lamp.irradiance[0])) for lamp in lamps] == [9, 6, 4]
    two = compact_lights(light, 2)
    assert len(two.lamps) == 2
    assert float(two.rest.radiance.max()) > 100  # the third stays in the map
    assert compact_lights(light, 0).lamps == []


def test_even_light_has_none() -> None:
    light = EnvironmentMap(radiance=smooth_sky(64).float())
    found = compact_lights(light, 3)
    assert found.lamps == []
    assert torch.equal(found.rest.radiance, light.radiance)


def test_a_sun_that_was_cut_off_is_told() -> None:
    towards = direction_from_angles(*torch.tensor([10.0, 40.0]).deg2rad().double())
    lit = smooth_sky(128) + disc(128, towards, math.radians(3), 12.0, fine=4)
    assert compact_lights(EnvironmentMap(radiance=lit.clamp(max=100).float()), 1).cut_off


# days of which the first place is outdoors, in the sun
@pytest.mark.parametrize("day", [2, 3, 8, 11, 12])
def test_suns_of_simulated_places_are_found(day: int) -> None:
    """Skies with clouds and aureoles, buildings and trees, whose sun is known."""
    record, rendered = simulate_place(day, 0, 128)
    assert record.kind == "outdoors"
    (sun,) = [light for light in rendered.lights if light.kind == "sun"]
    assert not sun.in_map
    light = rendered.map.with_light(sun.direction, sun.energy)
    found = compact_lights(light, 1)
    (lamp,) = found.lamps
    assert math.degrees(float(angle_between(lamp.direction, sun.direction))) < 0.5
    strength = float(luminance(lamp.irradiance) / luminance(sun.energy.double()))
    assert strength == pytest.approx(1, abs=0.05)
    assert worst_error(light, found) < 0.01
    assert disc_diameter_rad(lamp.spread_rad) == pytest.approx(2 * SUN_RADIUS_RAD, rel=1e-3)
