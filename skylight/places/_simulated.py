"""Simulated places: what a light model of the whole sphere is trained on.

Everything follows from a number: place ``k`` of day ``s`` draws from the seeds (s, k), the sky from
day ``s`` of :mod:`skylight.skies`. The same numbers give the same bytes on one machine.
"""

import csv
import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from datetime import datetime
from functools import lru_cache
from io import StringIO
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from skylight.errors import InputError
from skylight.io._atomic import atomic_path
from skylight.io._bounded import file_text
from skylight.io._files import INDEX_NAME, write_environment_map
from skylight.places._materials import Draw
from skylight.places._outdoors import Outdoors, draw_outdoors, night, open_air
from skylight.places._rooms import car, home, workplace
from skylight.places._scene import SUN_LUX, Outside, Scene, Surfaces
from skylight.places._stages import flash, street, studio
from skylight.places._view import DistinctLight, Rendered, render
from skylight.skies._atmosphere import ClearSky
from skylight.skies._index import Split
from skylight.skies._simulated import EVALUATION_SEEDS
from skylight.skies._simulator import DUSK_RAD, Day, draw_day, sunlit_moments
from skylight.sphere._frame import DirectionGrid, angles_from_direction
from skylight.work._progress import CountProgress
from skylight.work._resumable import SETTINGS, Workers, keep_settings, locked, share_work

PlaceKind = Literal["outdoors", "home", "workplace", "car", "studio", "street"]
# Half by daylight outdoors or in cars, a third in rooms, the rest where people are photographed
# on purpose or at night. They are weights of training, not of the world: none is below a
# twentieth, so that each kind is learnt.
SHARES: dict[PlaceKind, float] = {
    "outdoors": 0.42,
    "home": 0.24,
    "workplace": 0.12,
    "car": 0.06,
    "studio": 0.08,
    "street": 0.08,
}
# (the share of places of a kind with a flash on the camera, lux without it)
FLASH: dict[PlaceKind, tuple[float, float]] = {
    "outdoors": (0.03, 1e4),
    "home": (0.12, 150),
    "workplace": (0.06, 300),
    "car": (0.04, 1000),
    "studio": (0.06, 500),
    "street": (0.25, 10),
}
PER_DAY = 8
DARK_RAD = math.radians(92)  # zenith angle of a sun that is out of the question for rooms
LOW_SUN_RAD = math.radians(80)
ROOM_M = 0.2  # free about the viewer
LIGHTS_NAME = "lights.csv"


@dataclass(frozen=True, kw_only=True)
class PlaceRecord:
    """One map of an index. ``sun_zenith_deg`` is that of the sky outside, NaN where there is none.

    ``level`` is the mean luminance over the sphere, candelas per square metre.
    """

    file: str
    kind: PlaceKind
    ground: str
    split: Split
    seed: int  # the day's
    number: int  # of the place on that day
    sun_zenith_deg: float
    level: float


@dataclass(frozen=True, kw_only=True)
class LightRecord:
    """One distinct light of a map, the strongest first.

    ``red``, ``green`` and ``blue`` are its energy, relative radiance times steradians. ``in_map``
    is 1 where the map shows it too, and 0 where it is to be added to the map.
    """

    file: str
    kind: str
    azimuth_deg: float
    zenith_deg: float
    red: float
    green: float
    blue: float
    radius_deg: float
    in_map: int


def simulate_places(
    out: Path,
    *,
    count: int,
    seed: int = 0,
    height: int = 64,
    workers: Workers = 1,
    progress: CountProgress | None = None,
) -> Path:
    """Simulate ``count`` places into ``out``: maps (EXR, half precision), index.csv, lights.csv.

    Returns the index's path. Interrupted runs resume, and ``count`` may grow: eight places share a
    day, which counts as there once its part of the index is written. Every ninth day is for
    validation and every tenth for tests. ``progress`` hears how many places are there, of how many.
    """
    days = -(-count // PER_DAY)
    if seed < 0 or seed + days > EVALUATION_SEEDS:
        raise InputError(
            f"seeds {seed} to {seed + days - 1}: places have days of seeds from 0 to "
            f"{EVALUATION_SEEDS - 1}; the skies above are for evaluation"
        )
    parts = out / "days"
    with locked(out, parts):
        keep_settings(out / SETTINGS, {"height": height, "shares": SHARES})
        parts.mkdir(exist_ok=True)
        wanted = [(seed + k, min(PER_DAY, count - k * PER_DAY)) for k in range(days)]
        there = {day: len(read_places(_part(out, day))) for day, _ in wanted}
        missing = [(out, day, many, height) for day, many in wanted if there[day] < many]
        done = count - sum(many for _, _, many, _ in missing)
        if progress:
            progress(done, count)
        for many in share_work(_simulate_files, missing, workers=workers, finish=True):
            done += many
            if progress:
                progress(done, count)
        days_there = sorted(int(p.stem) for p in parts.glob("*.csv") if p.stem.isdecimal())
        rows = [row for day in days_there for row in read_places(_part(out, day))]
        lights = [(parts / f"{day}.lights.csv").read_text() for day in days_there]
        head = _text([], LightRecord)
        with atomic_path(out / LIGHTS_NAME) as temporary:
            temporary.write_text(head + "".join(each.removeprefix(head) for each in lights))
        _write(out / INDEX_NAME, rows)
    return out / INDEX_NAME


def read_places(path: Path) -> list[PlaceRecord]:
    """The rows of an index of places; none where there is no file."""
    if not path.exists():
        return []
    try:
        rows = csv.DictReader(StringIO(file_text(path), newline=""))
        return [_parsed(row) for row in rows]
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: not an index of places ({error}); simulate them anew") from error


def read_lights(path: Path) -> dict[str, list[LightRecord]]:
    """By file, the distinct lights of its map.

    Raises
    ------
    InputError
        It cannot be read, or has lights that are none.
    """
    found: dict[str, list[LightRecord]] = defaultdict(list)
    try:
        for row in csv.DictReader(StringIO(file_text(path), newline="")):
            light = _parsed_light(row)
            found[light.file].append(light)
    except (OSError, KeyError, TypeError, ValueError, csv.Error) as error:
        raise InputError(
            f"{path}: no list of the maps' lights ({error}); simulate the places anew, or move it "
            "away"
        ) from error
    return dict(found)


def _parsed_light(row: dict[str, str]) -> LightRecord:
    names = ("azimuth_deg", "zenith_deg", "red", "green", "blue", "radius_deg")
    reals = {name: float(row[name]) for name in names}
    if not all(map(math.isfinite, reals.values())) or min(list(reals.values())[2:]) < 0:
        raise ValueError(f"a light of {row['file']} is no light")
    return LightRecord(file=row["file"], kind=row["kind"], in_map=int(row["in_map"]), **reals)


def counts(records: Sequence[PlaceRecord]) -> str:
    """How many there are, of which kinds."""
    kinds = Counter(record.kind for record in records)
    return f"{len(records)} places ({', '.join(f'{kinds[kind]} {kind}' for kind in SHARES)})"


def simulate_place(day_seed: int, number: int, height: int = 64) -> tuple[PlaceRecord, Rendered]:
    """One place, from its numbers."""
    draw = Draw(np.random.default_rng([day_seed, number]))
    kind: PlaceKind = list(SHARES)[draw.one_of(list(SHARES.values()))]
    day, clear, moments = _day(day_seed)
    around = None
    low = [moment for moment in moments if moment[2] > LOW_SUN_RAD]
    if low and draw.chance(0.15):  # portraits are taken in the hour before dusk
        moments = low
    if moments and kind not in ("studio", "street"):
        around = draw_outdoors(day, clear, moments[draw.count(0, len(moments) - 1)], draw)
    elif moments and draw.chance(0.35):  # a street in the last light
        last = max(moments, key=lambda moment: moment[2])
        around = draw_outdoors(day, clear, last, draw) if kind == "street" else None
    scene, is_night = _scene(kind, around, draw)
    for _ in range(20):
        if _has_room(scene):
            break
        scene, is_night = _scene(kind, around, draw)
    share, lux = FLASH[kind]
    if draw.chance(share):
        scene.lamps.append(flash(draw, lux * draw.scale(0.5, 10), _reach(scene)))
    generator = torch.Generator().manual_seed(draw.count(0, 2**31 - 1))
    rendered = render(scene, height=height, generator=generator)
    by_day = around is not None and not is_night
    record = PlaceRecord(
        file=f"{day_seed:08d}_{number}.exr",
        kind=kind,
        ground=around.ground_name if around is not None and kind == "outdoors" else "",
        split=_split(day_seed),
        seed=day_seed,
        number=number,
        sun_zenith_deg=math.degrees(around.sun_zenith_rad) if by_day and around else math.nan,
        level=rendered.level * SUN_LUX,
    )
    return record, rendered


def _scene(kind: PlaceKind, around: Outdoors | None, draw: Draw) -> tuple[Scene, bool]:
    """(a scene of a kind, whether it is night)."""
    if kind == "studio":
        return studio(draw), True
    if around is None:
        return (street(night(draw), draw), True) if kind != "home" else _room(kind, None, draw)
    if kind == "street":
        return street(around.outside, draw), False
    if kind == "outdoors":
        return open_air(around, draw), False
    if kind == "car":
        return car(around.outside, draw), False
    return _room(kind, around, draw)


def _room(kind: PlaceKind, around: Outdoors | None, draw: Draw) -> tuple[Scene, bool]:
    dark = around is None or around.sun_zenith_rad > DARK_RAD or draw.chance(0.2)
    outside: Outside = night(draw) if dark or around is None else around.outside
    room = home if kind == "home" else workplace
    return room(outside, draw, dark=dark), dark


def _reach(scene: Scene) -> float:
    """How far it is to what the viewer sees towards the camera (+Z); windows are as walls."""
    surfaces = Surfaces.of(scene.rectangles)
    towards = torch.tensor([[0.0, 0.0, 1.0]])
    which, where = surfaces.hit(torch.zeros(1, 3), towards)
    return float(where.norm()) if int(which[0]) >= 0 else math.inf


def _has_room(scene: Scene) -> bool:
    """Whether the viewer stands in nothing, and nothing is too near."""
    surfaces = Surfaces.of([each for each in scene.rectangles if not each.window])
    directions = DirectionGrid.hammersley(256).directions.float()
    which, where = surfaces.hit(torch.zeros_like(directions), directions)
    on = which >= 0
    inside = (directions[on] * surfaces.normal[which[on]]).sum(1) > 0
    return not bool(inside.float().mean() > 0.1) and not bool(
        (where[on].norm(dim=1) < ROOM_M).any()
    )


@lru_cache(1)  # the places of a day come one after another
def _day(seed: int) -> tuple[Day, ClearSky, list[tuple[datetime, float, float]]]:
    day = draw_day(seed)
    moments = sunlit_moments(day, interval_min=10.0, lowest_sun_rad=DUSK_RAD)
    return day, ClearSky(day.atmosphere), moments


def _split(day_seed: int) -> Split:
    return "validation" if day_seed % 10 == 8 else "test" if day_seed % 10 == 9 else "train"


def _part(out: Path, day: int) -> Path:
    return out / "days" / f"{day}.csv"


def _simulate_files(out: Path, day: int, many: int, height: int) -> int:
    records, lights = [], []
    for number in range(many):
        record, rendered = simulate_place(day, number, height)
        write_environment_map(out / record.file, rendered.map, half=True)
        records.append(record)
        lights += [_light_record(record.file, light) for light in rendered.lights]
    with atomic_path(out / "days" / f"{day}.lights.csv") as temporary:
        temporary.write_text(_text(lights, LightRecord))
    _write(_part(out, day), records)
    return many


def _light_record(file: str, light: DistinctLight) -> LightRecord:
    azimuth, zenith = angles_from_direction(light.direction)
    red, green, blue = (float(f"{value:.6g}") for value in light.energy.tolist())
    return LightRecord(
        file=file,
        kind=light.kind,
        azimuth_deg=round(math.degrees(float(azimuth)), 3),
        zenith_deg=round(math.degrees(float(zenith)), 3),
        red=red,
        green=green,
        blue=blue,
        radius_deg=round(math.degrees(light.radius_rad), 4),
        in_map=int(light.in_map),
    )


def _write(path: Path, records: list[PlaceRecord]) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(_text(records, PlaceRecord))


def _text(records: Sequence, kind: type) -> str:
    stream = StringIO()
    writer = csv.DictWriter(stream, [f.name for f in fields(kind)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(record) for record in records)
    return stream.getvalue()


def _parsed(row: dict[str, str]) -> PlaceRecord:
    numbers = {name: int(row[name]) for name in ("seed", "number")}
    reals = {name: float(row[name]) for name in ("sun_zenith_deg", "level")}
    texts = {name: row[name] for name in ("file", "kind", "ground", "split")}
    return PlaceRecord(**texts, **numbers, **reals)  # type: ignore[arg-type]
