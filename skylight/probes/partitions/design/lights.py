"""Lights to optimise a design for: a folder of maps, or a day's simulated skies at a place."""

import math
from dataclasses import dataclass, replace
from datetime import date, timedelta
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.io.collection import INDEX_NAME, read_categories
from skylight.io.files import read_environment_map
from skylight.io.hdr import SUFFIXES
from skylight.io.listing import visible_files
from skylight.skies.clear.atmosphere import ClearSky
from skylight.skies.simulator import draw_day, simulate_sky, sunlit_moments
from skylight.skies.sun import Place, sun_midnight
from skylight.sphere.envmap import EnvironmentMap, shift_columns
from skylight.work.progress import StageProgress

MAP_HEIGHT = 32
_GROUND_ALBEDO = 0.2
_SKY_MINUTES = 60.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Lights:
    """Full maps (k,h,w,3) and their names; ``oriented`` ones must not be turned.

    Maps of one ``group`` (k) are alike and never divided between search and test.
    """

    maps: Float[Tensor, "k h w 3"]
    names: tuple[str, ...]
    groups: tuple[int, ...]
    oriented: bool = False


def read_maps(folder: Path, category: str | None = None) -> Lights:
    """All .exr and .hdr maps of a folder, or those of a category in its index.csv.

    Skies get a grey ground.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; give one with .exr or .hdr maps")
    if category is None:
        files = visible_files(folder, SUFFIXES)
        if not files:
            raise InputError(f"{folder}: there are no .exr or .hdr maps in this folder")
    else:
        found = read_categories(folder)
        files = [folder / name for name, kind in found.items() if kind == category]
        if not files:
            known = ", ".join(sorted(set(found.values())))
            raise InputError(
                f"{folder / INDEX_NAME}: no map is of category {category!r}: choose one of {known}"
            )
    maps = []
    for file in files:
        environment = read_environment_map(file)
        if not bool(environment.radiance.any()):
            raise InputError(f"{file}: the map is all black; take it out of the folder")
        maps.append(_whole(environment).radiance)
    return Lights(
        maps=torch.stack(maps),
        names=tuple(file.relative_to(folder).as_posix() for file in files),
        groups=tuple(range(len(files))),
    )


def simulated_lights(
    place: Place, day: date, *, weathers: int, tell: StageProgress = lambda _stage, _share: None
) -> Lights:
    """A day's skies at a place under many weathers, one an hour; -Z is north, +X east."""
    if weathers < 1:
        raise InputError(f"weathers must be 1 or more, got {weathers}")
    midnight = sun_midnight(place, day)
    maps, names, groups = [], [], []
    for number in range(weathers):
        tell("simulating skies", number / weathers)
        # not the same minutes under every weather, so that the sun is met all along its path
        start = midnight + timedelta(minutes=_SKY_MINUTES * number / weathers)
        weather = replace(draw_day(number), place=place, start=start)
        clear = ClearSky(weather.atmosphere)
        for moment in sunlit_moments(weather, interval_min=_SKY_MINUTES):
            sky = simulate_sky(weather, clear, *moment, height=MAP_HEIGHT // 2)
            # from half a column right of the middle, where the simulator puts the sun
            turn = torch.tensor([sky.sun_azimuth_rad - math.pi / (2 * MAP_HEIGHT)])
            radiance = _whole(sky.sky).radiance
            maps.append(shift_columns(radiance[None], turn.to(radiance))[0])
            names.append(f"weather {number}, {sky.time:%Y-%m-%d %H:%M} UTC")
            groups.append(number)
    if not maps:
        raise InputError(
            f"the sun does not rise at latitude {place.latitude_deg:g} on {day.isoformat()}: "
            "choose another day"
        )
    return Lights(maps=torch.stack(maps), names=tuple(names), groups=tuple(groups), oriented=True)


def _whole(environment: EnvironmentMap) -> EnvironmentMap:
    """As a full map of the search's size; below skies is a grey ground in their light."""
    if environment.is_sky:
        up = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
        environment = environment.resize(MAP_HEIGHT // 2)
        environment = environment.with_ground(_GROUND_ALBEDO / math.pi * environment.irradiance(up))
    return environment.resize(MAP_HEIGHT)
