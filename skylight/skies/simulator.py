"""Simulated days: a place, a date, an atmosphere, a cloud regime, and a sky every few minutes.

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

from skylight.skies.atmosphere import Atmosphere, ClearSky, henyey_greenstein
from skylight.skies.clouds import CloudLayer, cloud_light, optical_depth, unscattered
from skylight.skies.sun import SUN_RADIUS_RAD, Place, sun_angles
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.frame import direction_from_angles, pixel_from_direction
from skylight.sphere.grid import DirectionGrid

Regime = Literal["clear", "broken", "overcast"]
REGIME_SHARES: dict[Regime, float] = {"clear": 0.35, "broken": 0.4, "overcast": 0.25}
LOWEST_SUN_RAD = math.radians(2.0)
FORWARD_PEAK_G = 0.96  # width of the glow that thin cloud makes of the sun: about 5 degrees


@dataclass(frozen=True, kw_only=True)
class Day:
    """All that a day's skies depend on, and the seed that drew it."""

    seed: int
    place: Place
    start: datetime
    regime: Regime
    atmosphere: Atmosphere
    clouds: tuple[CloudLayer, ...]
    wind_km_per_hour: tuple[float, float]

    @property
    def name(self) -> str:
        return f"{self.start:%Y%m%d}-{self.seed}"


@dataclass(frozen=True, kw_only=True)
class SimulatedSky:
    """An upper-hemisphere map with the sun in the centre column, and where the sun really was."""

    sky: EnvironmentMap
    time: datetime
    sun_azimuth_rad: float  # clockwise from north
    sun_zenith_rad: float
    sun_transmittance: float  # unscattered, of the clouds alone: 1 is an open sun


def draw_day(seed: int) -> Day:
    """A random day; regimes by ``REGIME_SHARES``, places from the equator to 60 degrees."""
    rng = np.random.default_rng(seed)
    regime: Regime = rng.choice(list(REGIME_SHARES), p=list(REGIME_SHARES.values())).item()
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
        observer_km=float(rng.uniform(0.0, 1.5)),
    )
    wind = rng.normal(0, 15, size=2)
    return Day(
        seed=seed,
        place=place,
        start=start,
        regime=regime,
        atmosphere=air,
        clouds=_draw_clouds(regime, rng),
        wind_km_per_hour=(float(wind[0]), float(wind[1])),
    )


def _draw_clouds(regime: Regime, rng: np.random.Generator) -> tuple[CloudLayer, ...]:
    def layer(coverage: float, depth: float, height: float, cell: float, soft: float) -> CloudLayer:
        return CloudLayer(
            coverage=coverage,
            depth=depth,
            height_km=height,
            cell_km=cell,
            softness=soft,
            seed=int(rng.integers(1 << 30)),
        )

    if regime == "clear":
        if rng.random() < 0.6:
            return ()
        wisps = layer(rng.uniform(0.1, 0.5), rng.uniform(0.2, 1.5), 8.0, rng.uniform(6, 14), 0.9)
        return (wisps,)
    if regime == "broken":
        low = layer(
            rng.uniform(0.15, 0.75),
            float(rng.lognormal(math.log(14), 0.5)),
            rng.uniform(1.0, 3.5),
            rng.uniform(1.5, 5.0),
            rng.uniform(0.08, 0.4),
        )
        high = layer(rng.uniform(0.05, 0.4), rng.uniform(0.3, 2.0), 8.0, rng.uniform(6, 14), 0.9)
        return (high, low) if rng.random() < 0.4 else (low,)
    deck = layer(
        0.9999,
        float(rng.lognormal(math.log(28), 0.5)),
        rng.uniform(0.8, 3.0),
        rng.uniform(2.0, 8.0),
        rng.uniform(0.6, 2.0),
    )
    return (deck,)


def simulate_day(
    day: Day,
    *,
    interval_min: float,
    height: int = 32,
    device: torch.device | str = "cpu",
) -> Iterator[SimulatedSky]:
    """The day's skies, one every ``interval_min`` while the sun is above 2 degrees."""
    clear = ClearSky(day.atmosphere, device=device)
    for time, azimuth, zenith in sunlit_moments(day, interval_min=interval_min):
        yield simulate_sky(day, clear, time, azimuth, zenith, height=height)


def sunlit_moments(day: Day, *, interval_min: float) -> list[tuple[datetime, float, float]]:
    """(time, sun azimuth, sun zenith in rad), every ``interval_min`` with the sun above 2 deg."""
    count = int(24 * 60 / interval_min)
    times = [day.start + timedelta(minutes=interval_min * i) for i in range(count)]
    azimuth, zenith = sun_angles(day.place, times)
    return [
        (time, float(a), float(z))
        for time, a, z in zip(times, azimuth, zenith, strict=True)
        if z < math.pi / 2 - LOWEST_SUN_RAD
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
    """One sky, rendered at twice ``height`` and averaged, the sun exact in energy.

    The map is turned so that the sun stands on the middle of column w/2, the first to the
    right of the centre line: on one column rather than between two.
    """
    fine = 2 * height
    grid = DirectionGrid.sky(fine)
    device = clear.device
    directions = grid.directions.to(device, torch.float32)
    centre = math.pi / (4 * height)
    sun = _direction(centre, sun_zenith_rad).to(device)
    background = clear.radiance(directions, sun)
    solid = grid.solid_angles.to(device, torch.float32)
    direct = clear.sun_irradiance(torch.tensor([sun_zenith_rad], device=device))[0]
    # what the sky without clouds sends down: it lights the clouds from above
    open_sky = ((solid * directions[:, 1])[:, None] * background).sum(0)

    disc, share = _sun_disc(sun)
    points = torch.cat([directions, disc])
    hours = (time - day.start).total_seconds() / 3600
    footprint = math.pi / 2 / fine
    through_all = torch.ones(len(points), device=device)
    sharp = torch.ones(len(disc), device=device)
    radiance = torch.cat([background, torch.zeros(len(disc), 3, device=device)])
    turn = sun_azimuth_rad - centre  # from the map's azimuth to the world's
    world, toward = _turn(points, turn), _turn(sun[None], turn)[0]
    drift = (day.wind_km_per_hour[0] * hours, day.wind_km_per_hour[1] * hours)
    for layer in day.clouds:
        tau, incidence = optical_depth(layer, world, drift, 0.3 * hours, footprint)
        # light reaches a point of the sheet through the sheet a thickness further sunward
        ahead = 0.12 * layer.cell_km
        shifted = (
            drift[0] + ahead * float(toward[0]),
            drift[1] + ahead * float(toward[2]),
        )
        sunward, _ = optical_depth(layer, world, shifted, 0.3 * hours, footprint)
        through, glow = cloud_light(tau, sunward, incidence, points, sun, direct, open_sky)
        radiance = radiance * through[:, None] + glow
        through_all = through_all * through
        sharp = sharp * unscattered(tau[-len(disc) :], incidence[-len(disc) :])
    sky = radiance[: len(directions)]
    passed = (share * sharp).sum()
    # sunlight in the droplets' forward peak: lost to the disc, a glow round it
    peak = (share * through_all[-len(disc) :]).sum() - passed
    lobe = henyey_greenstein(directions @ sun, FORWARD_PEAK_G)
    sky = sky + peak * lobe[:, None] * direct
    fine_map = EnvironmentMap(radiance=sky.reshape(fine, 4 * fine, 3))
    radiance = fine_map.resize(height).radiance
    radiance = _add_disc(radiance, disc, share * sharp, direct)
    return SimulatedSky(
        sky=EnvironmentMap(radiance=radiance.cpu()),
        time=time,
        sun_azimuth_rad=sun_azimuth_rad,
        sun_zenith_rad=sun_zenith_rad,
        sun_transmittance=float(passed),
    )


def clear_variant(day: Day) -> Day:
    """The same day without clouds (for measurements against clear-sky references)."""
    return replace(day, regime="clear", clouds=())


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
