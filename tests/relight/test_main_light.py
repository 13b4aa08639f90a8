"""The sun taken out of a map: what is left and what was taken add up."""

import math

import torch

from skylight.relight._lamps import split_main_light
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, direction_from_angles


def smooth_sky(height: int = 64) -> torch.Tensor:
    x, y, z = DirectionGrid.latlong(height).directions.unbind(1)
    return torch.stack([1.2 + 0.4 * y, 1.4 + 0.5 * y - 0.2 * x, 1.8 + 0.6 * y + 0.1 * z], 1)


def with_sun(azimuth: float, zenith: float, power: float, radius: float) -> EnvironmentMap:
    """A smooth sky and a disc of light, grey-yellow."""
    grid = DirectionGrid.latlong(64)
    towards = direction_from_angles(torch.tensor(azimuth), torch.tensor(zenith)).double()
    disc = torch.acos((grid.directions @ towards).clamp(-1, 1)) < radius
    colour = torch.tensor([1.0, 0.9, 0.7], dtype=torch.float64)
    radiance = smooth_sky() + disc[:, None] * power * colour
    return EnvironmentMap(radiance=radiance.reshape(64, 128, 3).float())


def normals(count: int) -> torch.Tensor:
    return DirectionGrid.hammersley(count).directions


def test_a_sun_in_a_smooth_sky_is_found_and_taken() -> None:
    light = with_sun(0.7, 0.9, 5000.0, math.radians(3))
    main, rest = split_main_light(light)
    assert main.visible
    grid = light.grid
    truth = (light.flat.double() - smooth_sky()) * grid.solid_angles[:, None]
    vectors = truth.T @ grid.directions
    torch.testing.assert_close(main.irradiance, vectors.norm(dim=1), rtol=2e-3, atol=0)
    towards = vectors.sum(0) / vectors.sum(0).norm()
    assert math.degrees(math.acos(min(1.0, float(main.direction @ towards)))) < 0.01
    # what is left is the sky: the median round the sun stands for it
    left = (rest.flat.double() - smooth_sky()).abs()
    assert float(left.max()) < 0.05


def test_irradiance_is_kept_to_the_stated_bound() -> None:
    radius = math.radians(3)
    light = with_sun(-2.0, 1.2, 8000.0, radius)
    main, rest = split_main_light(light)
    worst, strength = 0.0, float(main.irradiance.max())
    for normal in normals(100):
        parallel = main.irradiance * (normal @ main.direction).clamp(min=0)
        both = rest.irradiance(normal).double() + parallel
        worst = max(worst, float((both - light.irradiance(normal).double()).abs().max()))
    assert worst < strength * math.sin(math.radians(4))
    # far below it: a normal that sees half a disc gets the mean of x+ over it, 2 r / (3 pi)
    assert worst < 2 * radius / (3 * math.pi) * strength
    facing = light.irradiance(main.direction).double()
    again = rest.irradiance(main.direction).double() + main.irradiance
    torch.testing.assert_close(again, facing, rtol=1e-5, atol=0)


def test_without_a_sun_all_stays_in_the_map() -> None:
    light = EnvironmentMap(radiance=smooth_sky().reshape(64, 128, 3).float())
    main, rest = split_main_light(light)
    assert not main.visible
    assert float(main.irradiance.abs().max()) == 0
    assert torch.equal(rest.radiance, light.radiance)


def test_a_dark_sky_over_a_lit_ground_has_no_sun() -> None:
    radiance = torch.zeros(16, 32, 3)
    radiance[8:] = 1.0
    main, _ = split_main_light(EnvironmentMap(radiance=radiance))
    assert not main.visible


def test_a_coarse_map_gives_its_brightest_pixel() -> None:
    radiance = torch.ones(8, 16, 3)
    radiance[2, 5] = 1000.0
    light = EnvironmentMap(radiance=radiance)
    main, rest = split_main_light(light)
    total = rest.integrate().double() + main.irradiance
    torch.testing.assert_close(total, light.integrate().double(), rtol=1e-3, atol=0)
