import math

import pytest
import torch

from skylight.skies.surroundings._buildings import Plan, _pulse, cross
from skylight.skies.surroundings._layer import EYE_M, Draws, Site, View, light_of
from skylight.skies.surroundings._terrain import FRINGE, Stand, _trunks, look

VIEW = View(32)


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


def draws() -> Draws:
    return Draws(count=1, generator=torch.Generator().manual_seed(0))


def test_a_crown_covers_the_area_of_its_ellipse() -> None:
    """pi a b, with a = radius / distance and b half its height in elevation, and its fringe."""
    stand = one_tree(
        azimuth=0.5, distance_m=60.0, height_m=12.0, radius_m=4.0, stem_m=EYE_M + 1, trunk_m=0.2
    )
    crown, left = look(stand, draws(), even_site())
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
    trunk = _trunks(stand, torch.full((1, 3), 0.1), draws(), even_site())
    step = math.pi / 2 / 32
    tall = float((trunk.cover.sum(1) > 0).any()) * step * len(trunk.cover[0])
    assert tall < math.atan2(height - EYE_M, 7.0) + step
