"""Folders of skies: EXR maps, an index, day-disjoint splits, and tensors to train on.

An index is ``index.csv`` beside the maps with the columns of :data:`COLUMNS`; simulated days
write it, and captured skies come in by writing one (or by :func:`index_folder`).
"""

import csv
import hashlib
import json
import math
import re
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.imaging.files import (
    atomic_path,
    read_environment_map,
    write_environment_map,
    write_json,
)
from skylight.skies.atmosphere import ClearSky
from skylight.skies.simulator import (
    Day,
    SimulatedSky,
    draw_day,
    simulate_day,
    simulate_sky,
    sunlit_moments,
)
from skylight.sphere.envmap import EnvironmentMap, luminance, shift_columns
from skylight.sphere.frame import angles_from_direction
from skylight.sphere.grid import DirectionGrid

Split = Literal["train", "validation", "test"]
INDEX_NAME = "index.csv"


@dataclass(frozen=True, kw_only=True)
class SkyRecord:
    """One map of an index. Angles in degrees, as people read them in the file.

    ``map_azimuth_deg`` is where the sun stands in the map (0 the centre, positive right);
    ``sun_azimuth_deg`` is clockwise from north where known. ``sun_transmittance`` is the part
    of the open sun that gets through unscattered (0 overcast, 1 open).
    """

    file: str
    day: str
    time: str
    regime: str
    sun_zenith_deg: float
    sun_azimuth_deg: float
    map_azimuth_deg: float
    sun_transmittance: float

    @property
    def split(self) -> Split:
        return split_of_day(self.day)


COLUMNS = tuple(f.name for f in fields(SkyRecord))
_NUMBERS = tuple(f.name for f in fields(SkyRecord) if f.type is float)


def split_of_day(day: str) -> Split:
    """train (8 in 10), validation or test (1 in 10 each) by a hash of the day's name.

    All skies of one day fall together, whatever else is in the folder, now or later.
    """
    bucket = int.from_bytes(hashlib.sha256(day.encode()).digest()[:4], "big") % 10
    return "train" if bucket < 8 else "validation" if bucket == 8 else "test"


def simulate_folder(
    out: Path,
    *,
    days: int,
    first_seed: int = 0,
    interval_min: float = 80.0,
    height: int = 32,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Simulate ``days`` days into ``out`` (EXR + index); days already there are kept.

    Returns the index's path. Interrupted runs resume: a day counts as there once its own part
    of the index is written, which happens after its maps.
    """
    parts = out / "days"
    parts.mkdir(parents=True, exist_ok=True)
    settings, note = {"interval_min": interval_min, "height": height}, out / "settings.json"
    if note.exists() and json.loads(note.read_text()) != settings:
        raise InputError(
            f"{out}: holds skies made with other settings ({note.read_text().strip()}); "
            "give the same interval and height, or another folder"
        )
    write_json(note, settings)
    seeds = range(first_seed, first_seed + days)
    missing = [s for s in seeds if not (parts / f"{s}.csv").exists()]
    done = days - len(missing)
    arguments = [(out, seed, interval_min, height) for seed in missing]
    if workers > 1:
        # one thread each: the workers already share the cores
        with ProcessPoolExecutor(workers, initializer=torch.set_num_threads, initargs=(1,)) as pool:
            for _ in pool.map(_simulate_day_files, arguments):
                done += 1
                if progress:
                    progress(done, days)
    else:
        for argument in arguments:
            _simulate_day_files(argument)
            done += 1
            if progress:
                progress(done, days)
    records = [r for s in seeds for r in _read_rows(parts / f"{s}.csv")]
    _write_rows(out / INDEX_NAME, records)
    return out / INDEX_NAME


def _simulate_day_files(argument: tuple[Path, int, float, int]) -> None:
    out, seed, interval_min, height = argument
    day = draw_day(seed)
    records = []
    for sky in simulate_day(day, interval_min=interval_min, height=height):
        name = f"{day.name}_{sky.time:%H%M}.exr"
        write_environment_map(out / name, sky.sky)
        records.append(_record(day, sky, name, height))
    _write_rows(out / "days" / f"{seed}.csv", records)


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
    )


def centre_column_azimuth(height: int) -> float:
    """Azimuth of the middle of column w/2 of a sky map, where training wants the sun."""
    return math.pi / (4 * height)


def read_index(folder: Path) -> list[SkyRecord]:
    """The records of ``folder/index.csv``."""
    path = folder / INDEX_NAME
    if not path.is_file():
        raise InputError(
            f"{path}: no index of skies there; `skylight skies simulate --out {folder}` makes "
            f"skies, `skylight skies index {folder}` indexes a folder of captured ones"
        )
    records = _read_rows(path)
    if not records:
        raise InputError(f"{path}: the index has no rows")
    return records


def index_folder(folder: Path) -> list[SkyRecord]:
    """Write an index for a folder of captured EXR/HDR skies; the sun is the brightest place.

    The capture day is the first YYYYMMDD in the file's name, otherwise the file's stem (each
    such map counts as a day of its own). ``sun_transmittance`` is estimated as 1 where the
    light within 4 degrees of the brightest direction gives more than half of the normal
    irradiance there, else 0.
    """
    records = []
    for path in sorted([*folder.glob("*.exr"), *folder.glob("*.hdr")]):
        sky = read_environment_map(path).upper()
        sun = sky.brightest_direction()
        azimuth, zenith = angles_from_direction(sun)
        grid = sky.grid
        cosine = (grid.directions @ sun).clamp(min=0)
        received = luminance(sky.flat).double() * grid.solid_angles * cosine
        share = float(received[cosine > math.cos(math.radians(4))].sum() / received.sum())
        day = re.search(r"(?:19|20)\d{6}", path.name)
        records.append(
            SkyRecord(
                file=path.name,
                day=day.group() if day else path.stem,
                time="",
                regime="clear" if share > 0.5 else "overcast",
                sun_zenith_deg=math.degrees(float(zenith)),
                sun_azimuth_deg=math.nan,
                map_azimuth_deg=math.degrees(float(azimuth)),
                sun_transmittance=float(share > 0.5),
            )
        )
    if not records:
        raise InputError(f"{folder}: no .exr or .hdr maps there to index")
    _write_rows(folder / INDEX_NAME, records)
    return records


def load_skies(
    folder: Path, records: list[SkyRecord], *, height: int = 32
) -> Float[Tensor, "n h w 3"]:
    """The maps of ``records``: sun turned to the centre column, mean luminance 1.

    ``height`` x ``4 height`` upper hemispheres, float32, area-averaged.
    """
    skies = [read_environment_map(folder / r.file).upper().resize(height) for r in records]
    batch = torch.stack([s.radiance for s in skies])
    azimuth = torch.tensor([math.radians(r.map_azimuth_deg) for r in records])
    return normalise(shift_columns(batch, centre_column_azimuth(height) - azimuth))


def normalise(skies: Float[Tensor, "n h w 3"]) -> Float[Tensor, "n h w 3"]:
    """Scale each sky to a mean luminance of 1 over the hemisphere, the sun included."""
    height, width = skies.shape[1:3]
    solid = DirectionGrid.latlong(height, width).solid_angles.reshape(height, width)
    mean = (luminance(skies).double() * solid).sum((1, 2)) / (2 * math.pi)
    return skies / mean.to(skies)[:, None, None, None]


def folder_hash(folder: Path, records: list[SkyRecord]) -> str:
    """SHA-256 over the records and the bytes of their maps: names a data set exactly."""
    digest = hashlib.sha256()
    for record in records:
        digest.update(repr(record).encode())
        try:
            digest.update((folder / record.file).read_bytes())
        except OSError as error:
            raise InputError(
                f"{folder / record.file}: in the index but not readable ({error.strerror}); "
                "bring the map back or index the folder again"
            ) from error
    return digest.hexdigest()


def simulated_skies(
    split: Split, count: int, *, first_seed: int, lowest_transmittance: float = 0.0
) -> list[tuple[SkyRecord, EnvironmentMap]]:
    """``count`` skies of a split's days, simulated on the spot: one random sky a day.

    Seeds run upwards from ``first_seed``; days of other splits are passed over, and skies whose
    sun gets through by less than ``lowest_transmittance`` too (six tries a day).
    """
    found: list[tuple[SkyRecord, EnvironmentMap]] = []
    seed = first_seed
    while len(found) < count:
        day = draw_day(seed)
        rng = np.random.default_rng(seed)
        seed += 1
        if split_of_day(day.name) != split:
            continue
        moments = sunlit_moments(day, interval_min=10.0)
        clear = ClearSky(day.atmosphere)
        for i in rng.permutation(len(moments))[:6]:
            sky = simulate_sky(day, clear, *moments[i], height=32)
            if sky.sun_transmittance >= lowest_transmittance:
                found.append((_record(day, sky, "", 32), sky.sky))
                break
    return found


def _read_rows(path: Path) -> list[SkyRecord]:
    try:
        with path.open(newline="") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as an index of skies ({error})") from error
    try:
        return [_parse(row) for row in rows]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: not an index of skies ({error}); its columns are {', '.join(COLUMNS)}"
        ) from error


def _parse(row: dict[str, Any]) -> SkyRecord:
    values: dict[str, Any] = {c: float(row[c]) if c in _NUMBERS else row[c] for c in COLUMNS}
    return SkyRecord(**values)


def _write_rows(path: Path, records: list[SkyRecord]) -> None:
    with atomic_path(path) as temporary, temporary.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, COLUMNS)
        writer.writeheader()
        writer.writerows(asdict(r) for r in records)
