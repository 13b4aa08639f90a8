"""Designs with small cells along the sun's path, so that shadows in sunlight are sharp.

The sun's path of a day is very nearly a circle about the celestial pole. Such a circle, and the
piece of it that is meant, are given by three points on it (thesis, 4.3.2, where they lie on one
great circle, as they do at an equinox): it runs from the first through the middle to the last.

Here are also the lights that designs are optimised for: the maps of a folder, or the simulated
skies of a day at a place.
"""

import math
from dataclasses import dataclass, replace
from datetime import date, timedelta
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.io._files import INDEX_NAME, read_categories, read_environment_map, visible_files
from skylight.io._hdr import SUFFIXES
from skylight.probes.partitions._cells import Cells, voronoi
from skylight.probes.partitions._seeds import ProbeDesign
from skylight.skies._atmosphere import ClearSky
from skylight.skies._simulator import draw_day, simulate_sky, sunlit_moments
from skylight.skies._sun import Place, sun_angles, sun_midnight
from skylight.sphere._envmap import EnvironmentMap, shift_columns
from skylight.sphere._frame import direction_from_angles, rotation_about
from skylight.work._progress import StageProgress

_STRIP_WIDTH_RAD = math.radians(20.0)
_SHORTEST_RAD = math.radians(30.0)
_ROOM_AT_ENDS = 1.2  # cells
_MINUTES_OF_DAY = 24 * 60


@dataclass(frozen=True, kw_only=True, eq=False)
class SunPath:
    """From ``start`` (3,), unit, by ``turn_rad`` about ``axis`` (3,), unit, right-handed."""

    axis: Float[Tensor, "3"]
    start: Float[Tensor, "3"]
    turn_rad: float

    @property
    def length_rad(self) -> float:
        """How far the sun goes on the sphere."""
        return self.turn_rad * float(torch.linalg.cross(self.axis, self.start).norm())

    def at(self, fractions: list[float]) -> Float[Tensor, "k 3"]:
        """Places on the path: 0 its start, 1 its end; beyond, on the same circle."""
        turns = [rotation_about(self.axis, f * self.turn_rad) for f in fractions]
        return torch.stack([turn @ self.start for turn in turns])


def path_through(
    first: Float[Tensor, "3"], middle: Float[Tensor, "3"], last: Float[Tensor, "3"]
) -> SunPath:
    """The arc of the circle through three directions, in this order."""
    a, b, c = (v.double() / v.double().norm() for v in (first, middle, last))
    axis = torch.linalg.cross(b - a, c - b)
    if float(axis.norm()) < 1e-3 * float((b - a).norm() * (c - b).norm()) or bool(
        ((b - a).norm() < 1e-3) | ((c - b).norm() < 1e-3)
    ):
        raise InputError("a sun path needs three different directions")
    axis = axis / axis.norm()
    from_centre, to_centre = (v - (v @ axis) * axis for v in (a, c))
    sine = axis @ torch.linalg.cross(from_centre, to_centre)
    turn = math.atan2(float(sine), float(from_centre @ to_centre)) % (2 * math.pi)
    return SunPath(axis=axis, start=a, turn_rad=turn)


def sun_path(place: Place, day: date) -> SunPath:
    """The circle through where the sun rises, stands highest and sets; -Z is north, +X east.

    The day is that of the place's sun time. The sun is at most 0.3 degrees off the circle, since
    its declination changes while it crosses the sky.
    """
    directions = sun_directions(place, day)
    up = torch.nonzero(directions[:, 1] > 0)[:, 0]
    if len(up) in (0, len(directions)):
        what = "rise" if not len(up) else "set"
        raise InputError(
            f"the sun does not {what} at latitude {place.latitude_deg:g} on {day.isoformat()}: "
            "choose another day, or a design without a sun path"
        )
    highest = directions[:, 1].argmax()
    return path_through(directions[up[0]], directions[highest], directions[up[-1]])


def sun_directions(place: Place, day: date) -> Float[Tensor, "1441 3"]:
    """Where the sun stands, from midnight to midnight in the place's sun time, every minute."""
    midnight = sun_midnight(place, day)
    times = [midnight + timedelta(minutes=i) for i in range(_MINUTES_OF_DAY + 1)]
    azimuth, zenith = sun_angles(place, times)
    return direction_from_angles(torch.from_numpy(azimuth), torch.from_numpy(zenith))


def path_design(name: str, base: ProbeDesign, cells: int, path: SunPath) -> ProbeDesign:
    """A strip of equal cells 20 degrees wide along a path, and the cells of ``base`` around it.

    Three rows of seeds a width apart follow the path and go one cell beyond its ends. Regions of
    the middle row, but for the two at the ends, are the strip's cells and come first. All others
    are merged into the cell of the closest seed of ``base`` on their side of the path, or on the
    path. Seeds of ``base`` so close to the path that they would take a part of the strip are left
    out; a cell that the strip cuts in two becomes two. Where a cell around the strip could not be
    built (see :class:`Cells`), all are cut in two along the path's noon.
    """
    _check_path(cells, path)
    middles = path.at([(j + 0.5) / cells for j in range(-1, cells + 1)])
    across = path.axis - (middles @ path.axis)[:, None] * middles
    across = across / across.norm(dim=1, keepdim=True)
    sine, cosine = math.sin(_STRIP_WIDTH_RAD), math.cos(_STRIP_WIDTH_RAD)
    strip, caps = middles[1:-1], middles[[0, -1]]
    flanks = torch.cat([caps, cosine * middles + sine * across, cosine * middles - sine * across])
    reach = math.hypot(path.length_rad / cells, _STRIP_WIDTH_RAD)
    near = torch.cdist(base.seeds, middles).amin(1) < 2 * math.sin(reach / 2)
    others = torch.cat([flanks, base.seeds[~near]])

    height = math.sin(_STRIP_WIDTH_RAD / 2)
    base_side = _side(base.seeds, path, height)
    apart = _side(others, path, height)[:, None] * base_side[None] < 0
    closeness = torch.where(apart, -2.0, others @ base.seeds.T)
    owner = base.labels[closeness.argmax(1)]
    seeds = torch.cat([strip, others])
    labels = torch.cat([torch.arange(cells), cells + owner])
    design = ProbeDesign(name=name, seeds=seeds, labels=_parted(seeds, labels), oriented=True)
    try:
        Cells.of(design)
    except InputError:
        # round the ends of short or narrow paths cells can get too wide for their faces
        noon = path.at([0.5])[0]
        late = others @ torch.linalg.cross(path.axis, noon) > 0
        labels = torch.cat([torch.arange(cells), cells + 2 * owner + late])
        design = replace(design, labels=_parted(seeds, labels))
        try:
            Cells.of(design)
        except InputError as error:
            raise InputError(
                f"around {cells} cells along this path no other cells can be built from "
                f"{base.name}: take more, or a finer base"
            ) from error
    return design


def _side(directions: Float[Tensor, "m 3"], path: SunPath, height: float) -> Float[Tensor, " m"]:
    """Of the path's plane: 1 towards its axis, -1 away, 0 within the strip."""
    distance = (directions - path.start) @ path.axis
    return torch.where(distance.abs() < height, 0.0, distance.sign())


def _parted(seeds: Float[Tensor, "s 3"], labels: Tensor) -> Tensor:
    """New labels 0..n-1 in the order of the old: one for each connected piece."""
    piece = voronoi(seeds).pieces(labels)
    keys = torch.stack([labels, piece.to(labels)], 1)
    return keys.unique(dim=0, return_inverse=True)[1]


def _check_path(cells: int, path: SunPath) -> None:
    if cells < 1:
        raise InputError(f"a sun path needs 1 cell or more, got {cells}")
    if path.length_rad < _SHORTEST_RAD:
        raise InputError(
            f"the sun's path is only {math.degrees(path.length_rad):.0f} degrees long, less than "
            "30: choose another day, or a design without a sun path"
        )
    # half a cell beyond either end, and some of the night, must remain
    if path.turn_rad * (1 + _ROOM_AT_ENDS / cells) > 2 * math.pi:
        raise InputError(
            f"the sun's path turns by {math.degrees(path.turn_rad):.0f} degrees, which leaves no "
            f"room to end {cells} cells: take more cells, or another day"
        )


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
