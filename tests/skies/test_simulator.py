import hashlib
import math
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise

import pytest
import torch
from hypothesis import given, settings, strategies as st

from skylight.skies._atmosphere import Atmosphere, ClearSky
from skylight.skies._clouds import CloudLayer
from skylight.skies._simulator import (
    DAY_RAD,
    DUSK_RAD,
    REGIME_SHARES,
    Day,
    SimulatedSky,
    _add_disc,
    _air_before,
    _at_hour,
    _direction,
    _sun_disc,
    draw_day,
    simulate_day,
    simulate_sky,
    sunlit_moments,
)
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid, angle_between, direction_from_angles
from tests.skies.clear_days import without_clouds

UP = torch.tensor([0.0, 1.0, 0.0])


def digest(skies: list[SimulatedSky]) -> str:
    return hashlib.sha256(b"".join(s.sky.radiance.numpy().tobytes() for s in skies)).hexdigest()


def sky_under(day: Day, clear: ClearSky, sun_zenith_deg: float, height: int = 16) -> SimulatedSky:
    return simulate_sky(day, clear, day.start, 1.0, math.radians(sun_zenith_deg), height=height)


def sun_in_map(sky: SimulatedSky) -> torch.Tensor:
    azimuth = torch.tensor(math.pi / (4 * sky.sky.layout[0]), dtype=torch.float64)
    zenith = torch.tensor(sky.sun_zenith_rad, dtype=torch.float64)
    return direction_from_angles(azimuth, zenith)


@pytest.fixture(scope="module")
def clear_day() -> Day:
    return without_clouds(draw_day(2))


@pytest.fixture(scope="module")
def clear_air(clear_day: Day) -> ClearSky:
    return ClearSky(clear_day.atmosphere)


def test_same_seed_same_bytes() -> None:
    first = list(simulate_day(draw_day(7), interval_min=240.0, height=8))
    again = list(simulate_day(draw_day(7), interval_min=240.0, height=8))
    other = list(simulate_day(draw_day(6), interval_min=240.0, height=8))
    assert digest(first) == digest(again) != digest(other)


def test_regimes_come_by_their_shares() -> None:
    days = [draw_day(seed) for seed in range(500)]
    for regime, share in REGIME_SHARES.items():
        found = sum(d.regime == regime for d in days) / len(days)
        assert found == pytest.approx(share, abs=0.06)
    assert {len(d.clouds) for d in days if d.regime == "clear"} == {0, 1}
    assert {len(d.clouds) for d in days if d.regime == "broken"} == {1, 2, 3}
    assert {len(d.clouds) for d in days if d.regime == "overcast"} == {1, 2}
    for day in days:  # the highest first, one above the other
        for upper, lower in pairwise(day.clouds):
            assert upper.base_km >= lower.base_km + lower.thickness_km


def test_moments_are_daylight_of_one_day() -> None:
    for seed in range(10):
        day = draw_day(seed)
        moments = sunlit_moments(day, interval_min=30.0)
        assert all(z < math.pi / 2 - DAY_RAD for _, _, z in moments)
        times = [t for t, _, _ in moments]
        assert all(day.start <= t for t in times)
        # the start is about local midnight, so the day's light is one unbroken stretch
        steps = {b - a for a, b in pairwise(times)}
        assert len(steps) <= 1


def test_interval_does_not_move_the_first_moment() -> None:
    day = draw_day(3)
    coarse = sunlit_moments(day, interval_min=60.0)
    fine = sunlit_moments(day, interval_min=20.0)
    assert set(coarse) <= set(fine)


@settings(deadline=None, max_examples=40)
@given(zenith_deg=st.floats(0, 88), height=st.sampled_from([8, 16, 32, 64]))
def test_disc_energy_is_exact_on_any_grid(zenith_deg: float, height: int) -> None:
    """sum_w L dw = E for the disc alone, whichever pixels it falls on."""
    sun = _direction(math.pi / (4 * height), math.radians(zenith_deg))
    disc, share = _sun_disc(sun)
    colour = torch.tensor([3.0, 2.0, 1.0])
    radiance = _add_disc(torch.zeros(height, 4 * height, 3), disc, share, colour)
    total = EnvironmentMap(radiance=radiance).integrate()
    torch.testing.assert_close(total, colour, rtol=2e-6, atol=0)


def test_disc_has_the_suns_size_and_limb() -> None:
    sun = _direction(0.3, 0.8)
    disc, share = _sun_disc(sun)
    angle = angle_between(disc, sun.expand_as(disc)).rad2deg()
    assert float(angle.max()) < 0.2667
    # equal solid angles: the mean squared radius of a disc is half its radius squared
    assert float((angle**2).mean()) == pytest.approx(0.2667**2 / 2, rel=1e-3)
    assert float(share.sum()) == pytest.approx(1, abs=1e-6)
    # limb darkening 1 - 0.6 (1 - sqrt(1 - r^2)) from the first to the last of six rings
    limb = [1 - 0.6 * (1 - math.sqrt(1 - r2)) for r2 in (1 / 12, 11 / 12)]
    assert float(share.max() / share.min()) == pytest.approx(limb[0] / limb[1], rel=1e-4)
    assert float(angle_between((share[:, None] * disc).sum(0), sun).rad2deg()) < 1e-2


@pytest.mark.parametrize("zenith_deg", [10.0, 80.0])
def test_sun_of_a_clear_sky(clear_day: Day, clear_air: ClearSky, zenith_deg: float) -> None:
    """In column w/2, in its true place, and with the energy of the beam whatever the grid."""
    beam = clear_air.sun_irradiance(torch.tensor([math.radians(zenith_deg)]))[0]
    totals = []
    for height in (8, 32):
        sky = sky_under(clear_day, clear_air, zenith_deg, height)
        assert sky.sun_transmittance == pytest.approx(1, abs=1e-5)
        values = luminance(sky.sky.radiance)
        assert int(values.argmax()) % (4 * height) == 2 * height
        totals.append(sky.sky.integrate())
        if height == 32:
            found = sky.sky.brightest_direction()
            assert float(angle_between(found, sun_in_map(sky)).rad2deg()) < 1.5
    grid = DirectionGrid.sky(32)
    diffuse = clear_air.radiance(
        grid.directions.float(), sun_in_map(sky_under(clear_day, clear_air, zenith_deg)).float()
    )
    expected = beam + EnvironmentMap(radiance=diffuse.reshape(32, 128, 3)).integrate()
    for total in totals:
        torch.testing.assert_close(total, expected, rtol=0.03, atol=0)


@pytest.mark.parametrize(("height_deg", "low", "high"), [(-0.8, 410.0, 585.0), (-6.0, 2.0, 3.5)])
def test_twilight_fades_as_measured(height_deg: float, low: float, high: float) -> None:
    """Illuminance in lx at the ends of civil twilight, from the American Meteorological Society's
    glossary ("civil twilight"); ours, in clean air, is up to 1.6 times as much."""
    clear = ClearSky(Atmosphere(observer_km=0.0))
    grid = DirectionGrid.sky(32)
    sun = direction_from_angles(torch.tensor(0.0), torch.tensor(math.radians(90 - height_deg)))
    sky = clear.radiance(grid.directions.float(), sun)
    weight = (grid.solid_angles * grid.directions[:, 1]).float()
    illuminance = 133_300 * float(luminance((weight[:, None] * sky).sum(0)))
    assert low <= illuminance <= 1.6 * high


def test_a_sky_is_what_is_without_the_sun_and_the_suns_irradiance() -> None:
    """Under clouds too: the disc's pixels hold what a plane that faces the sun receives of it."""
    seen = []
    for seed in range(6):
        sky = next(simulate_day(draw_day(seed), interval_min=200.0, height=16))
        disc = EnvironmentMap(radiance=sky.sky.radiance - sky.sunless.radiance)
        torch.testing.assert_close(disc.integrate(), sky.sun_irradiance, rtol=1e-3, atol=1e-4)
        assert ((disc.radiance > 1e-3).sum((0, 1)) <= 4).all()
        seen.append(sky.sun_transmittance)
    assert min(seen) < 0.1
    assert max(seen) > 0.9


def test_a_set_sun_is_not_in_the_map(clear_day: Day, clear_air: ClearSky) -> None:
    """Nor are clouds after dusk lit from below the horizon by more than before it."""
    set_ = sky_under(clear_day, clear_air, 92.0)
    assert set_.sun_transmittance == 0.0
    sun = sun_in_map(set_).float()
    background = clear_air.radiance(DirectionGrid.sky(24).directions.float(), sun)
    assert float(set_.sky.radiance.max()) <= float(background.max())
    cloudy = replace(
        clear_day, clouds=draw_day(7, shares={"clear": 0.0, "broken": 1.0, "overcast": 0.0}).clouds
    )
    levels = [
        float(sky_under(cloudy, clear_air, z).sky.radiance.mean()) for z in (88.0, 91.0, 94.0)
    ]
    assert levels[0] > 2 * levels[1] > 4 * levels[2] > 0


def test_twilight_is_simulated_where_it_is_asked_for() -> None:
    day = draw_day(3)
    light = sunlit_moments(day, interval_min=10.0)
    more = sunlit_moments(day, interval_min=10.0, lowest_sun_rad=DUSK_RAD)
    assert set(light) < set(more)
    assert all(90 - 2 < math.degrees(z) < 90 + 6 for _, _, z in set(more) - set(light))


def days_of(regime: str, count: int) -> list[Day]:
    return [d for d in map(draw_day, range(60)) if d.regime == regime][:count]


def test_open_suns_stand_where_they_are_said_to() -> None:
    checked = 0
    for day in days_of("broken", 2):
        for sky in simulate_day(day, interval_min=240.0, height=32):
            if sky.sun_transmittance > 0.8:
                found = sky.sky.brightest_direction()
                assert float(angle_between(found, sun_in_map(sky)).rad2deg()) < 1.6
                checked += 1
    assert checked >= 2


def test_clouds_take_the_sun_and_make_no_energy(clear_day: Day, clear_air: ClearSky) -> None:
    """A deck lets less through the thicker it is."""
    open_sky = luminance(sky_under(clear_day, clear_air, 40).sky.irradiance(UP))
    before = 1.0
    for depth in (1.0, 5.0, 20.0, 60.0):
        layer = CloudLayer(coverage=2.0, depth=depth, softness=1.0, cell_km=40.0, seed=3)
        day = Day(**{**vars(clear_day), "clouds": (layer,)})
        sky = sky_under(day, clear_air, 40)
        ratio = float(luminance(sky.sky.irradiance(UP)) / open_sky)
        assert 0.05 < ratio < 1.02
        assert ratio < before + 0.02
        before = ratio
    assert sky.sun_transmittance < 1e-3


def test_broken_clouds_brighten_by_less_than_measured_extremes() -> None:
    """Cloud enhancement: sunlit cloud sides lift irradiance by up to about 1.5 times."""
    ratios = []
    for day in days_of("broken", 2):
        air = ClearSky(day.atmosphere)
        for moment in sunlit_moments(day, interval_min=240.0):
            cloudy = simulate_sky(day, air, *moment, height=8).sky.irradiance(UP)
            open_sky = simulate_sky(without_clouds(day), air, *moment, height=8).sky.irradiance(UP)
            ratios.append(float(luminance(cloudy) / luminance(open_sky)))
    assert 0.05 < min(ratios) < 0.9
    assert max(ratios) < 1.6


def test_overcast_skies_are_brighter_above() -> None:
    """Zenith over horizon: 3 for the CIE overcast sky, less where the sun shows through."""
    ratios = []
    for day in days_of("overcast", 2):
        for sky in simulate_day(day, interval_min=300.0, height=16):
            rows = luminance(sky.sky.radiance).mean(1)
            ratios.append(float(rows[:2].mean() / rows[-2:].mean()))
    assert 1.5 < sum(ratios) / len(ratios) < 4


def test_haze_lies_before_far_clouds(clear_air: ClearSky) -> None:
    """Transmittance falls and the share of the sky's light before a cloud grows with distance."""
    mu = torch.linspace(0.02, 1, 50)
    towards = torch.stack([torch.sqrt(1 - mu**2), mu, torch.zeros(50)], -1)
    through, share = _air_before(clear_air, towards, 2.0)
    for part in (through, share):
        assert ((part >= 0) & (part <= 1)).all()
    assert (torch.diff(through[:, 1]) > -1e-4).all()
    assert float(through[-1, 1]) > 0.8
    assert float(share[0, 1]) > float(share[-1, 1])
    # nothing lies before a cloud at the observer
    none, empty = _air_before(clear_air, towards, 0.0)
    torch.testing.assert_close(none, torch.ones_like(none), rtol=0, atol=1e-3)
    assert float(empty.max()) < 1e-2


def test_no_sun_shines_in_the_air_under_a_thick_deck(clear_day: Day, clear_air: ClearSky) -> None:
    """The clear sky's glow round a low sun is gone: the horizon is nearly even all round."""
    thick = CloudLayer(coverage=9.0, depth=80.0, softness=1e-3, erosion=0.0, base_km=1.0)
    day = Day(**{**vars(clear_day), "clouds": (thick,)})
    horizon = luminance(sky_under(day, clear_air, 78.0).sky.radiance)[-2]
    assert float(horizon.max() / horizon.min()) < 1.15
    open_sky = luminance(sky_under(clear_day, clear_air, 78.0).sky.radiance)[-2]
    assert float(open_sky.max() / open_sky.min()) > 3


def test_cover_waxes_and_wanes_but_overcast_stays() -> None:
    for regime, most in (("broken", 0.25), ("overcast", 0.0)):
        day = days_of(regime, 1)[0]
        cover = [_at_hour(day.clouds[-1], day, float(hour)).coverage for hour in range(24)]
        assert max(cover) - min(cover) <= most + 1e-9
        assert (max(cover) > min(cover)) == (regime == "broken")
        depth = [_at_hour(day.clouds[-1], day, float(hour)).depth for hour in range(24)]
        assert 1.2 < max(depth) / min(depth) < 2


def test_clouds_move_with_the_wind() -> None:
    day = days_of("broken", 1)[0]
    air = ClearSky(day.atmosphere)
    at_noon = (datetime(2020, 1, 1, 12, tzinfo=UTC), 1.0, 0.8)
    day = Day(**{**vars(day), "start": datetime(2020, 1, 1, tzinfo=UTC)})
    still = Day(**{**vars(day), "wind_km_per_hour": (0.0, 0.0)})
    moved = simulate_sky(day, air, *at_noon, height=8).sky.radiance
    stayed = simulate_sky(still, air, *at_noon, height=8).sky.radiance
    assert not torch.allclose(moved, stayed, rtol=0.01)
