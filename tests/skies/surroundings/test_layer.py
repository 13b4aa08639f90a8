"""What layers cover of a sky map, the light on them, and the things they show."""

import math

import pytest
import torch

from skylight.skies.surroundings._buildings import Plan, _pulse, cross
from skylight.skies.surroundings._layer import (
    EYE_M,
    Draws,
    Layer,
    Light,
    Site,
    View,
    in_air,
    light_of,
    rough_noise,
)
from skylight.skies.surroundings._terrain import FRINGE, Stand, _trunks, look
from skylight.sphere._frame import DirectionGrid


def draws(count: int, seed: int = 0) -> Draws:
    return Draws(count=count, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("height", [8, 32, 64])
def test_cover_integrates_to_the_interval(height: int) -> None:
    view = View(height)
    low = draws(3).uniform((0.0, 0.7), view.parts)
    high = low + draws(3, seed=1).uniform((0.0, 0.8), view.parts)
    rows = view.between(low, high)
    assert ((rows >= 0) & (rows <= 1 + 1e-6)).all()
    step = math.pi / 2 / height
    torch.testing.assert_close(rows.sum(1) * step, high - low, rtol=0, atol=1e-5)
    assert not view.between(high, low).any()


def test_strips_keep_their_width_across_the_map_s_border() -> None:
    view = View(32)
    azimuth = torch.tensor([[0.3, math.pi, -math.pi + 1e-3]])
    half = torch.tensor([[1e-3, 0.02, 0.3]])
    cover = view.across(azimuth, half).sum(-1) * 2 * math.pi / view.parts
    torch.testing.assert_close(cover, 2 * half, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(("rows", "columns", "roughness"), [(64, 256, 0.5), (1, 256, 1.5)])
def test_noise_has_mean_zero_and_variance_one(rows: int, columns: int, roughness: float) -> None:
    noise = rough_noise(draws(400), rows, columns, roughness)
    torch.testing.assert_close(noise.mean((1, 2)), torch.zeros(400), rtol=0, atol=1e-5)
    assert float(noise.square().mean()) == pytest.approx(1, abs=0.05)


def test_a_larger_map_has_the_same_texture() -> None:
    small, large = (View(height).texture(draws(4), 0.8) for height in (32, 64))
    averaged = large.unflatten(1, (32, 2)).mean(2).unflatten(2, (-1, 2)).mean(3)
    inner = slice(1, -1)  # the outermost rows are averaged with fewer neighbours
    error = (averaged - small)[:, inner].square().mean().sqrt()
    assert float(error) < 0.25 * float(small.std())
    seam = (small[..., 0] - small[..., -1]).square().mean()
    within = (small[..., 1] - small[..., 0]).square().mean()
    assert float(seam) < 4 * float(within)


def test_a_view_up_to_an_elevation_is_the_lower_part_of_the_whole() -> None:
    view = View(32)
    part = view.up_to(0.5)
    assert (part.rows - 1) * math.pi / 2 / 32 < 0.5 <= part.rows * math.pi / 2 / 32
    assert part.elevation.equal(view.elevation[-part.rows :])
    low, high = torch.zeros(1, view.parts), torch.full((1, view.parts), 0.5)
    whole = view.between(low, high)
    assert part.between(low, high).equal(whole[:, -part.rows :])
    assert not whole[:, : -part.rows].any()
    assert part.texture(draws(2), 0.8).equal(view.texture(draws(2), 0.8)[:, -part.rows :])


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


def plan(azimuth: float, distance: float, turn: float = 0.0, half=(6.0, 3.0)) -> Plan:
    return Plan(
        azimuth=torch.tensor([[azimuth]]),
        distance_m=torch.tensor([[distance]]),
        half_m=torch.tensor([[half]]),
        turn=torch.tensor([[turn]]),
    )


def test_a_wall_square_to_the_view_is_seen_along_a_line() -> None:
    """At azimuth a its distance is (d - depth / 2) / cos a, its half width tan a times that."""
    hit = cross(plan(0.0, 20.0), VIEW)
    azimuth = VIEW.azimuth
    front = (azimuth.abs() < math.atan(6 / 17)).clone()
    assert hit.hit[0, 0].equal(front)
    torch.testing.assert_close(hit.enter[0, 0][front], 17 / torch.cos(azimuth[front]))
    torch.testing.assert_close(
        hit.place[0, 0][front], 17 * torch.tan(azimuth[front]), atol=1e-4, rtol=0
    )
    torch.testing.assert_close(hit.ridge[0, 0][front], 20 / torch.cos(azimuth[front]))
    assert not hit.gable[0, 0][front].any()
    towards = torch.tensor([0.0, 0.0, 1.0]).expand(int(front.sum()), 3)
    torch.testing.assert_close(hit.normal[0, 0][front], towards, atol=1e-6, rtol=0)


def test_who_stands_inside_is_surrounded() -> None:
    hit = cross(plan(1.0, 1.0), VIEW)
    assert hit.hit.all()
    assert not hit.enter.any()
    assert float(hit.leave.max()) == pytest.approx(math.hypot(6, 4), rel=0.01)
    assert float(hit.leave.min()) == pytest.approx(2, rel=0.01)


def test_plans_turn_and_mirror_with_their_azimuth() -> None:
    step = 2 * math.pi / VIEW.parts
    here, turned = cross(plan(0.4, 9.0, 0.3), VIEW), cross(plan(0.4 + 50 * step, 9.0, 0.3), VIEW)
    mirrored = cross(plan(-0.4, 9.0, -0.3), VIEW)
    assert here.hit.roll(50, -1).equal(turned.hit)
    assert here.hit.flip(-1).equal(mirrored.hit)
    for name in ("enter", "leave"):
        a, b, c = (
            torch.where(each.hit, getattr(each, name), 0.0) for each in (here, turned, mirrored)
        )
        torch.testing.assert_close(a.roll(50, -1), b, rtol=1e-4, atol=1e-4)
        torch.testing.assert_close(a.flip(-1), c, rtol=1e-4, atol=1e-4)


def test_windows_take_their_share_however_small() -> None:
    share = torch.tensor(0.3)
    x = torch.linspace(0, 5, 5001)[:-1]
    for width in (0.01, 0.5, 1.0, 7.3):
        wave = _pulse(x, share, torch.tensor(width))
        assert float(wave.mean()) == pytest.approx(0.3, abs=1e-3)
        assert float(wave.min()) > -1e-4
        assert float(wave.max()) < 1 + 1e-3
    torch.testing.assert_close(
        _pulse(x, share, torch.tensor(1.0)), torch.full_like(x, 0.3), rtol=0, atol=1e-4
    )


def one_tree(**measures: float) -> Stand:
    return Stand(
        **{name: torch.tensor([[value]]) for name, value in measures.items()},
        pointed=torch.tensor([[False]]),
        standing=torch.tensor([[True]]),
    )


def even_site() -> Site:
    light = light_of(torch.ones(1, 32, 128, 3), VIEW, torch.zeros(1, 3))
    each = torch.ones(1)
    return Site(view=VIEW, light=light, open=each, visibility_m=each, snow=each)


def test_a_crown_covers_the_area_of_its_ellipse() -> None:
    """pi a b, with a = radius / distance and b half its height in elevation, and its fringe."""
    stand = one_tree(
        azimuth=0.5, distance_m=60.0, height_m=12.0, radius_m=4.0, stem_m=EYE_M + 1, trunk_m=0.2
    )
    crown, left = look(stand, draws(1), even_site())
    assert left.standing.all()
    pixel = (math.pi / 2 / 32) * (2 * math.pi / VIEW.parts)
    half = (math.atan2(12 - EYE_M, 60) - math.atan2(1, 60)) / 2
    want = math.pi * FRINGE**2 * (4 / 60) * half
    assert float(crown.reach.sum()) * pixel == pytest.approx(want, rel=0.03)
    shape = crown.reach[0].sum(0) > 0
    assert float(VIEW.azimuth[shape].mean()) == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("height", [2.0, 4.0, 15.0])
def test_a_trunk_ends_below_the_top_of_its_crown(height: float) -> None:
    stand = one_tree(
        azimuth=0.5, distance_m=7.0, height_m=height, radius_m=1.0, stem_m=0.0, trunk_m=0.2
    )
    trunk = _trunks(stand, torch.full((1, 3), 0.1), draws(1), even_site())
    step = math.pi / 2 / 32
    tall = float((trunk.cover.sum(1) > 0).any()) * step * len(trunk.cover[0])
    assert tall < math.atan2(height - EYE_M, 7.0) + step
