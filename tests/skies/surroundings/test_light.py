import math

import torch

from skylight.skies.surroundings._layer import Layer, Light, Site, View, in_air, light_of
from skylight.sphere._frame import DirectionGrid

VIEW = View(32)
UP, DOWN, NORTH = (torch.tensor([[v]]) for v in ([0.0, 1, 0], [0.0, -1, 0], [0.0, 0, -1]))
ONE = torch.tensor(1.0)


def light(sky: torch.Tensor, albedo: float = 0.0) -> Light:
    return light_of(sky[None], VIEW, torch.full((1, 3), albedo))


def test_a_uniform_sky_gives_pi_from_above_and_half_of_it_to_walls() -> None:
    uniform = light(torch.ones(32, 128, 3), albedo=0.5)
    for normal, want in ((UP, math.pi), (NORTH, 0.75 * math.pi), (DOWN, 0.5 * math.pi)):
        got = uniform.irradiance(normal, ONE, ONE)
        torch.testing.assert_close(got, torch.full((1, 1, 3), want), rtol=1e-3, atol=0)
    assert not uniform.beam.any()


def test_a_sun_is_told_from_the_sky_and_casts_its_light_by_the_cosine() -> None:
    sky = torch.full((32, 128, 3), 0.1)
    sky[20, 64] = 1000.0
    found = light(sky)
    grid = DirectionGrid.sky(32)
    number = 20 * 128 + 64
    sun = grid.directions[number].float()
    torch.testing.assert_close(found.sun[0], sun, rtol=0, atol=1e-5)
    whole = 1000.0 * float(grid.solid_angles[number])
    assert torch.all((found.beam > 0.9 * whole) & (found.beam < whole))
    facing, off = sun[None, None], torch.linalg.cross(sun, UP[0, 0])[None, None]
    shaded, lit = (found.irradiance(facing, ONE, torch.tensor(t)) for t in (0.0, 1.0))
    torch.testing.assert_close((lit - shaded)[:, 0], found.beam, rtol=1e-4, atol=0)
    torch.testing.assert_close(
        found.irradiance(off, ONE, ONE), found.irradiance(off, ONE, torch.tensor(0.0))
    )


def test_light_turns_with_the_sky() -> None:
    sky = torch.rand(32, 128, 3, generator=torch.Generator().manual_seed(0))
    turned = light(torch.roll(sky, 32, dims=1))  # a quarter turn, from -Z to +X
    east = torch.tensor([[[1.0, 0.0, 0.0]]])
    torch.testing.assert_close(
        turned.irradiance(east, ONE, ONE), light(sky).irradiance(NORTH, ONE, ONE)
    )


def test_air_leaves_a_fiftieth_of_the_contrast_at_the_distance_of_visibility() -> None:
    sky = torch.ones(32, 128, 3)
    site = Site(
        view=VIEW,
        light=light(sky),
        open=torch.ones(1),
        visibility_m=torch.tensor([5000.0]),
        snow=torch.zeros(1),
    )
    size = (1, 32, VIEW.parts)
    for distance, contrast in ((0.0, 1.0), (5000.0, 0.02), (2500.0, math.sqrt(0.02))):
        black = Layer(
            cover=torch.ones(size),
            radiance=torch.zeros(*size, 3),
            distance_m=torch.full((1, VIEW.parts), distance),
        )
        seen = 1 - in_air(black, site)
        torch.testing.assert_close(seen, torch.full_like(seen, contrast), rtol=0.02, atol=1e-6)


def test_what_reaches_over_the_sun_is_before_it() -> None:
    sky = torch.full((32, 128, 3), 0.1)
    sky[20, 64] = 1000.0
    elevation = math.pi / 2 * (1 - 20.5 / 32)
    column = slice(64 * 4, 65 * 4)
    low, high = torch.full((1, 3, VIEW.parts), 9.0), torch.full((1, 3, VIEW.parts), -9.0)
    low[0, :, column] = 0.0
    high[0, 0, column] = elevation + 0.2
    high[0, 1, column] = elevation - 0.2
    low[0, 2], high[0, 2] = low[0, 0].roll(200), high[0, 0].roll(200)
    assert light(sky).before_sun(low, high).tolist() == [[True, False, False]]
