"""Simulated days: place, date, atmosphere and cloud regime, a sky every few minutes.

Everything follows from the day's seed: the same seed gives the same bytes on one device.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.skies._atmosphere import EARTH_RADIUS_KM, Atmosphere, ClearSky
from skylight.skies._clouds import CloudLayer, Wind, march, shadow
from skylight.skies._sun import SUN_RADIUS_RAD, Place, sun_angles
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, direction_from_angles, pixel_from_direction

Regime = Literal["clear", "broken", "overcast"]
REGIME_SHARES: dict[Regime, float] = {"clear": 0.35, "broken": 0.4, "overcast": 0.25}
DUSK_RAD = math.radians(-6.0)  # height of the sun where civil twilight ends
DAY_RAD = math.radians(2.0)  # and where it lights as by day


@dataclass(frozen=True, kw_only=True)
class Day:
    """All that a day's skies depend on, and the seed that drew it."""

    seed: int
    place: Place
    start: datetime
    regime: Regime
    atmosphere: Atmosphere
    clouds: tuple[CloudLayer, ...]
    wind_km_per_hour: tuple[float, float]  # east, south
    weather: tuple[float, float]  # phases of the clouds' slow change over the day

    @property
    def name(self) -> str:
        return f"{self.start:%Y%m%d}-{self.seed}"


@dataclass(frozen=True, kw_only=True)
class SimulatedSky:
    """An upper-hemisphere map with the sun in the centre column, and where the sun really was.

    ``sky`` is ``sunless`` and the ``sun_irradiance`` of the disc, behind clouds, on a plane that
    faces it, in the pixels that the disc covers.
    """

    sky: EnvironmentMap
    sunless: EnvironmentMap
    sun_irradiance: Float[Tensor, "3"]
    time: datetime
    sun_azimuth_rad: float  # clockwise from north
    sun_zenith_rad: float
    sun_transmittance: float  # unscattered, of the clouds: 1 is an open sun, 0 one that is set


def draw_day(seed: int, *, shares: dict[Regime, float] = REGIME_SHARES) -> Day:
    """A random day; regimes by ``shares`` (sum 1), places from the equator to 60 degrees."""
    rng = np.random.default_rng(seed)
    regime: Regime = rng.choice(list(shares), p=list(shares.values())).item()
    place = Place(
        latitude_deg=float(rng.uniform(-60, 60)), longitude_deg=float(rng.uniform(-180, 180))
    )
    start = datetime(2015, 1, 1, tzinfo=UTC) + timedelta(days=int(rng.integers(0, 8 * 365)))
    # about local midnight, so that one pass through 24 hours is one day; not the same minutes
    # every day, so that coarse intervals still meet all sun heights
    start += timedelta(hours=-place.longitude_deg / 15, minutes=float(rng.uniform(0, 60)))
    air = Atmosphere(
        aerosol_optical_depth=float(np.clip(rng.lognormal(math.log(0.12), 0.6), 0.03, 0.6)),
        angstrom_exponent=float(rng.uniform(0.6, 1.8)),
        ozone=float(rng.uniform(0.8, 1.3)),
        ground_albedo=float(rng.uniform(0.05, 0.3)),
        observer_km=float(rng.uniform(0.0, 0.7)),
    )
    wind = rng.normal(0, 15, size=2)
    return Day(
        seed=seed,
        place=place,
        start=start,
        regime=regime,
        atmosphere=air,
        clouds=tuple(_draw_clouds(regime, rng)),
        wind_km_per_hour=(float(wind[0]), float(wind[1])),
        weather=(float(rng.uniform(0, 2 * math.pi)), float(rng.uniform(0, 2 * math.pi))),
    )


# What the numbers of a layer are drawn from, in this order: evenly from a range, but ``depth``,
# which is lognormal, of a median and a standard deviation of the logarithm.
_CIRRUS = {
    "coverage": (0.2, 0.9),
    "depth": (0.8, 0.7),
    "base_km": (7.0, 9.5),
    "thickness_km": (0.3, 1.2),
    "cell_km": (4.0, 12.0),
    "softness": (0.5, 1.0),
    "erosion": (0.3, 0.8),
    "stretch": (1.0, 4.0),
}
_HEAPS = {
    "coverage": (0.15, 0.75),
    "depth": (25.0, 0.6),
    "base_km": (0.9, 2.5),
    "thickness_km": (0.4, 2.5),
    "cell_km": (1.2, 5.0),
    "softness": (0.05, 0.25),
    "towering": (0.1, 0.5),
    "erosion": (0.1, 0.4),
}
_PATCHES = {
    "coverage": (0.2, 0.9),
    "depth": (6.0, 0.7),
    "base_km": (2.5, 5.0),
    "thickness_km": (0.2, 0.6),
    "cell_km": (1.0, 6.0),
    "softness": (0.15, 0.6),
    "erosion": (0.2, 0.6),
    "stretch": (1.0, 2.0),
}
_DECK = {
    "coverage": (1.0, 1.3),
    "depth": (22.0, 0.7),
    "base_km": (0.8, 3.0),
    "thickness_km": (0.4, 1.5),
    "cell_km": (2.0, 8.0),
    "softness": (0.6, 1.3),
    "erosion": (0.1, 0.3),
}


def _draw_clouds(regime: Regime, rng: np.random.Generator) -> list[CloudLayer]:
    """The layers of a day, the highest first."""

    def layer(kind: dict[str, tuple[float, float]]) -> CloudLayer:
        drawn = {
            name: float(rng.lognormal(math.log(a), b) if name == "depth" else rng.uniform(a, b))
            for name, (a, b) in kind.items()
        }
        return CloudLayer(**drawn, seed=int(rng.integers(1 << 30)))

    if regime == "clear":
        return [layer(_CIRRUS)] if rng.random() < 0.4 else []
    if regime == "overcast":
        whole = layer(_DECK)
        if rng.random() < 0.75:
            return [whole]
        scud = replace(
            layer(_HEAPS), base_km=rng.uniform(0.6, 1.2), thickness_km=rng.uniform(0.3, 1.2)
        )
        return [replace(whole, base_km=rng.uniform(2.5, 4.0)), scud]
    high = [layer(_CIRRUS)] if rng.random() < 0.4 else []
    if rng.random() < 0.4:
        return [*high, layer(_PATCHES)]
    middle = (
        [replace(layer(_PATCHES), base_km=rng.uniform(5.2, 6.2))] if rng.random() < 0.25 else []
    )
    return [*high, *middle, layer(_HEAPS)]


def simulate_day(
    day: Day,
    *,
    interval_min: float,
    lowest_sun_rad: float = DAY_RAD,
    height: int = 32,
) -> Iterator[SimulatedSky]:
    """The day's skies, those of :func:`sunlit_moments`."""
    clear = ClearSky(day.atmosphere)
    moments = sunlit_moments(day, interval_min=interval_min, lowest_sun_rad=lowest_sun_rad)
    for time, azimuth, zenith in moments:
        yield simulate_sky(day, clear, time, azimuth, zenith, height=height)


def sunlit_moments(
    day: Day, *, interval_min: float, lowest_sun_rad: float = DAY_RAD
) -> list[tuple[datetime, float, float]]:
    """(time, sun azimuth, sun zenith in rad), every ``interval_min`` with the sun so high."""
    count = int(24 * 60 / interval_min)
    times = [day.start + timedelta(minutes=interval_min * i) for i in range(count)]
    azimuth, zenith = sun_angles(day.place, times)
    return [
        (time, float(a), float(z))
        for time, a, z in zip(times, azimuth, zenith, strict=True)
        if z < math.pi / 2 - lowest_sun_rad
    ]


def simulate_sky(
    day: Day,
    clear: ClearSky,
    time: datetime,
    sun_azimuth_rad: float,
    sun_zenith_rad: float,
    *,
    height: int,
) -> SimulatedSky:
    """One sky, rendered at 1.5 times ``height`` and averaged, the sun exact in energy.

    Each layer of clouds throws its shadow on those below it, and the forward peak of what it
    scatters falls with the shadow. What the air under the clouds scatters is lit by the mean of
    what passes them. The map is turned so that the sun stands on the middle of column w/2, the
    first to the right of the centre line: on one column rather than between two.
    """
    fine = height + height // 2
    grid = DirectionGrid.sky(fine)
    device = clear.device
    directions = grid.directions.to(device, torch.float32)
    centre = math.pi / (4 * height)
    sun = _direction(centre, sun_zenith_rad).to(device)
    zenith = torch.tensor([sun_zenith_rad], device=device)
    direct = clear.sun_irradiance(zenith)[0]
    disc, share = _sun_disc(sun)
    world = _turn(torch.cat([directions, disc]), sun_azimuth_rad - centre)
    sun_world = _turn(sun[None], sun_azimuth_rad - centre)[0]
    background = clear.radiance(directions, sun)
    weight = (grid.solid_angles.to(device, torch.float32) * directions[:, 1])[:, None]

    risen = (disc[:, 1] > 0).to(share)
    sky, beam_share, sharp = background, 1.0, risen
    hours = (time - day.start).total_seconds() / 3600
    east, south = (hours * speed for speed in day.wind_km_per_hour)
    wind = Wind(east_km=east, south_km=south, change=0.3 * hours)
    above_it: list[tuple[CloudLayer, Wind]] = []
    for layer in day.clouds:
        middle_km = layer.base_km + layer.thickness_km / 2
        now = _at_hour(layer, day, hours), wind
        light = march(
            now[0],
            world,
            sun_world,
            now[1],
            footprint_rad=math.pi / 2 / fine,
            ground_albedo=day.atmosphere.ground_albedo,
        )
        lit = math.prod(
            (shadow(*upper, world, middle_km, sun_world) for upper in above_it),
            start=torch.ones(len(world), device=device),
        )
        above_it.append(now)
        beam = clear.sun_irradiance(zenith, height_km=middle_km)[0]
        above = (weight * sky).sum(0)  # what this layer gets of diffuse light
        own = (lit * light.beam)[:, None] * beam + light.sky[:, None] * above
        passed, own = light.passed[: len(directions), None], own[: len(directions)]
        air, haze = _air_before(clear, directions, middle_km)
        # over the hemisphere's floor: how much of a high beam passes
        beam_share *= float((passed * weight).sum() / weight.sum())
        # the air under a cloud scatters what is left of the sun, and light from all sides
        under = (weight * (sky * passed + own)).sum(0)
        around = under * (1 + day.atmosphere.ground_albedo) / (2 * math.pi)
        haze = haze * (beam_share * background + (1 - beam_share) * around)
        sky = haze + (sky - haze).clamp(min=0) * passed + air * own
        sharp = sharp * torch.exp(-light.depth[len(directions) :])
    fine_map = EnvironmentMap(radiance=sky.reshape(fine, 4 * fine, 3))
    sunless = fine_map.resize(height).radiance
    radiance = _add_disc(sunless, disc, share * sharp, direct)
    return SimulatedSky(
        sky=EnvironmentMap(radiance=radiance.cpu()),
        sunless=EnvironmentMap(radiance=sunless.cpu()),
        sun_irradiance=((share * sharp).sum() * direct).cpu(),
        time=time,
        sun_azimuth_rad=sun_azimuth_rad,
        sun_zenith_rad=sun_zenith_rad,
        sun_transmittance=float((share * sharp).sum()),
    )


def _at_hour(layer: CloudLayer, day: Day, hours: float) -> CloudLayer:
    """Cover and depth wax and wane over the day, by a tenth of the sky and a third of the depth."""
    cover, depth = (math.sin(2 * math.pi * hours / 9 + phase) for phase in day.weather)
    swing = 0.1 if layer.coverage < 1 else 0.0  # an overcast day stays one
    return replace(
        layer,
        coverage=max(0.02, layer.coverage + swing * cover),
        depth=layer.depth * math.exp(0.3 * depth),
    )


def _air_before(
    clear: ClearSky,
    directions: Float[Tensor, "n 3"],
    height_km: float,
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3"]]:
    """(transmittance of the air up to a height, the share of the sky's radiance before it).

    The share is that of the ray's extinction, as if the air's source were the same all along.
    """
    observer = EARTH_RADIUS_KM + clear.atmosphere.observer_km
    shell = EARTH_RADIUS_KM + max(height_km, clear.atmosphere.observer_km)
    mu = directions[:, 1].clamp(min=1e-3)
    beyond = torch.sqrt(1 - (observer / shell) ** 2 * (1 - mu**2))
    whole = clear.transmittance(torch.full_like(mu, observer), mu)
    behind = clear.transmittance(torch.full_like(mu, shell), beyond)
    before = (whole / behind.clamp(min=1e-30)).clamp(0, 1)
    share = ((1 - before) / (1 - whole).clamp(min=1e-6)).clamp(0, 1)
    return clear.as_colour(before), clear.as_colour(share)


def _sun_disc(sun: Float[Tensor, "3"]) -> tuple[Float[Tensor, "k 3"], Float[Tensor, " k"]]:
    """Directions across the solar disc and their shares of its irradiance (sum 1).

    Rings of equal solid angle; limb darkening 1 - 0.6 (1 - cos psi), the visual mean
    (Cox 2000, section 14.7).
    """
    rings, per_ring = 6, 16
    ring = (torch.arange(rings, device=sun.device) + 0.5) / rings
    phi = 2 * math.pi * (torch.arange(per_ring, device=sun.device) + 0.5) / per_ring
    radius = torch.sqrt(ring).repeat_interleave(per_ring)
    phi = phi.repeat(rings)
    helper = torch.tensor([1.0, 0.0, 0.0], device=sun.device)
    u = torch.linalg.cross(sun, helper)
    u = u / u.norm()
    v = torch.linalg.cross(sun, u)
    offset = radius * math.tan(SUN_RADIUS_RAD)
    disc = sun + offset[:, None] * (torch.cos(phi)[:, None] * u + torch.sin(phi)[:, None] * v)
    share = 1 - 0.6 * (1 - torch.sqrt(1 - radius**2))
    return disc / disc.norm(dim=-1, keepdim=True), share / share.sum()


def _add_disc(
    radiance: Float[Tensor, "h w 3"],
    disc: Float[Tensor, "k 3"],
    share: Float[Tensor, " k"],
    irradiance: Float[Tensor, "3"],
) -> Float[Tensor, "h w 3"]:
    """Spread the sun's irradiance over the pixels its disc covers: L += E share / dw."""
    height, width = radiance.shape[:2]
    row, column = pixel_from_direction(disc, height, width)
    r = torch.round(row).long().clamp(0, height - 1)
    c = torch.round(column).long() % width
    solid = DirectionGrid.sky(height).solid_angles.reshape(height, width)[:, 0].to(radiance)
    flat = radiance.reshape(-1, 3).clone()
    flat.index_add_(0, r * width + c, (share / solid[r])[:, None] * irradiance)
    return flat.reshape(height, width, 3)


def _direction(azimuth: float, zenith: float) -> Float[Tensor, "3"]:
    return direction_from_angles(torch.tensor(azimuth), torch.tensor(zenith))


def _turn(directions: Float[Tensor, "n 3"], azimuth: float) -> Float[Tensor, "n 3"]:
    x, y, z = directions.unbind(-1)
    c, s = math.cos(azimuth), math.sin(azimuth)
    return torch.stack([c * x - s * z, y, s * x + c * z], -1)
