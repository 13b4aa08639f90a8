"""Simulated skies: folders of whole days for training, and single skies for evaluation."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from skylight.errors import InputError
from skylight.io._files import write_environment_map
from skylight.skies._atmosphere import ClearSky
from skylight.skies._index import (
    INDEX_NAME,
    SkyRecord,
    centre_column_azimuth,
    divide,
    read_rows,
    write_rows,
)
from skylight.skies._simulator import (
    DUSK_RAD,
    REGIME_SHARES,
    Day,
    Regime,
    SimulatedSky,
    draw_day,
    simulate_day,
    simulate_sky,
    sunlit_moments,
)
from skylight.sphere._envmap import EnvironmentMap
from skylight.work._progress import CountProgress
from skylight.work._resumable import SETTINGS, Workers, keep_settings, locked, share_work

# Skies simulated on the spot come from seeds from here on, which no folder may use: so nothing
# is ever evaluated on a day that something was trained on.
EVALUATION_SEEDS = 30_000_000


@dataclass(frozen=True, kw_only=True)
class SimulationSettings:
    """What a day's maps depend on besides its seed; ``shares`` of the regimes sum to 1."""

    interval_min: float
    height: int
    shares: dict[Regime, float]
    lowest_sun_deg: float


def simulate_folder(
    out: Path,
    *,
    days: int,
    first_seed: int = 0,
    interval_min: float = 80.0,
    height: int = 32,
    shares: dict[Regime, float] = REGIME_SHARES,
    lowest_sun_deg: float = math.degrees(DUSK_RAD),
    workers: Workers = 1,
    progress: CountProgress | None = None,
) -> Path:
    """Simulate ``days`` days into ``out`` (EXR + index); days already there are kept.

    Returns the index's path. Interrupted runs resume: a day counts as there once its own part
    of the index is written, which happens after its maps. The days are divided into splits at
    the end, all of them together. ``progress`` hears how many days are there, and of how many.
    """
    if first_seed < 0 or first_seed + days > EVALUATION_SEEDS:
        raise InputError(
            f"seeds {first_seed} to {first_seed + days - 1}: skies to train on have seeds from 0 "
            f"to {EVALUATION_SEEDS - 1}; those above are for evaluation"
        )
    # in one order: it decides which regime a seed draws
    shares = {regime: shares.get(regime, 0.0) for regime in REGIME_SHARES}
    settings = SimulationSettings(
        interval_min=interval_min, height=height, shares=shares, lowest_sun_deg=lowest_sun_deg
    )
    parts = out / "days"
    with locked(out, parts):
        keep_settings(out / SETTINGS, asdict(settings))
        parts.mkdir(exist_ok=True)
        seeds = range(first_seed, first_seed + days)
        missing = [s for s in seeds if not (parts / f"{s}.csv").exists()]
        done = days - len(missing)
        if progress:
            progress(done, days)
        work = [(out, seed, settings) for seed in missing]
        for _ in share_work(_simulate_day_files, work, workers=workers, finish=True):
            done += 1
            if progress:
                progress(done, days)
        days_there = (part for part in parts.glob("*.csv") if part.stem.isdecimal())
        in_order = sorted(days_there, key=lambda part: int(part.stem))
        records = [r for part in in_order for r in read_rows(part)]
        write_rows(out / INDEX_NAME, divide(records))
    return out / INDEX_NAME


def simulated_skies(
    count: int, *, first_seed: int, lowest_transmittance: float = 0.0
) -> list[tuple[SkyRecord, EnvironmentMap]]:
    """The maps of :func:`evaluation_skies`."""
    found = evaluation_skies(
        count, first_seed=first_seed, lowest_transmittance=lowest_transmittance
    )
    return [(record, simulated.sky) for record, simulated in found]


def evaluation_skies(
    count: int, *, first_seed: int, lowest_transmittance: float = 0.0
) -> list[tuple[SkyRecord, SimulatedSky]]:
    """``count`` skies simulated on the spot: one random sky a day, the sun above 2 degrees.

    Seeds run upwards from :data:`EVALUATION_SEEDS` + ``first_seed``; skies whose sun gets
    through by less than ``lowest_transmittance`` are passed over (six tries a day).
    """
    if first_seed < 0:
        raise InputError(f"first_seed must be at least 0, got {first_seed}")
    found: list[tuple[SkyRecord, SimulatedSky]] = []
    seed = EVALUATION_SEEDS + first_seed
    while len(found) < count:
        day = draw_day(seed)
        rng = np.random.default_rng(seed)
        seed += 1
        moments = sunlit_moments(day, interval_min=10.0)
        clear = ClearSky(day.atmosphere)
        for i in rng.permutation(len(moments))[:6]:
            sky = simulate_sky(day, clear, *moments[i], height=32)
            if sky.sun_transmittance >= lowest_transmittance:
                found.append((_record(day, sky, "", 32), sky))
                break
    return found


def _simulate_day_files(out: Path, seed: int, settings: SimulationSettings) -> None:
    day = draw_day(seed, shares=settings.shares)
    records = []
    lowest = math.radians(settings.lowest_sun_deg)
    for sky in simulate_day(
        day, interval_min=settings.interval_min, lowest_sun_rad=lowest, height=settings.height
    ):
        name = f"{day.name}_{sky.time:%H%M}.exr"
        write_environment_map(out / name, sky.sky)
        records.append(_record(day, sky, name, settings.height))
    write_rows(out / "days" / f"{seed}.csv", records)


def _record(day: Day, sky: SimulatedSky, file: str, height: int) -> SkyRecord:
    return SkyRecord(
        file=file,
        day=day.name,
        time=f"{sky.time:%Y-%m-%dT%H:%M:%SZ}",
        regime=day.regime,
        sun_zenith_deg=math.degrees(sky.sun_zenith_rad),
        sun_azimuth_deg=math.degrees(sky.sun_azimuth_rad),
        map_azimuth_deg=math.degrees(centre_column_azimuth(height)),
        sun_transmittance=sky.sun_transmittance,
        latitude_deg=day.place.latitude_deg,
        longitude_deg=day.place.longitude_deg,
        seed=day.seed,
    )


def regime_shares(
    *, clear: float | None, broken: float | None, overcast: float | None
) -> dict[Regime, float]:
    """Shares of days that sum to 1: those not given are 0; the usual ones where none is given."""
    given: dict[Regime, float | None] = {"clear": clear, "broken": broken, "overcast": overcast}
    if all(share is None for share in given.values()):
        return REGIME_SHARES
    weights: dict[Regime, float] = {regime: given[regime] or 0.0 for regime in REGIME_SHARES}
    total = sum(weights.values())
    if not all(0 <= w < math.inf for w in weights.values()) or not 0 < total < math.inf:
        options = ", ".join(f"--{name} {share:g}" for name, share in weights.items())
        raise InputError(f"shares must be 0 or more, and one of them above 0, got {options}")
    return {regime: weight / total for regime, weight in weights.items()}
