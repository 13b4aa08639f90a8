"""The index of a folder of skies: ``index.csv``, its splits, and its skies as tensors.

Training, validation and test days are drawn by rejection (thesis, 5.3.3.1): each set has a similar
mixture of sunny and overcast skies, and all skies of one capture day are in one set. Skies are
loaded with the sun in the centre column and a mean luminance of 1.
"""

import csv
import hashlib
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from io import StringIO
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from skylight.errors import InputError
from skylight.io._atomic import atomic_path
from skylight.io._bounded import file_text
from skylight.io._files import INDEX_NAME
from skylight.skies._layouts import Layout, read_sky
from skylight.sphere._envmap import luminance, shift_columns
from skylight.sphere._frame import DirectionGrid

Split = Literal["train", "validation", "test"]
_MAY_BE_EMPTY = ("sun_azimuth_deg", "latitude_deg", "longitude_deg", "field_deg")
SHARES = (0.8, 0.1, 0.1)
TRIES = 5000
SUNNY = 0.5  # transmittance from which on a sky counts as sunny
_SEED = 20180101


@dataclass(frozen=True, kw_only=True)
class SkyRecord:
    """One map of an index. Angles in degrees, as people read them in the file.

    ``file`` is relative to the index, or absolute where the maps lie elsewhere. ``day`` is what
    a split must not cut. ``split`` is None until the days of a folder are divided.
    ``map_azimuth_deg`` is where the sun stands in the map (0 the centre, positive right);
    ``sun_azimuth_deg`` is clockwise from north. ``sun_transmittance`` is the part of the open
    sun that gets through unscattered (0 overcast, 1 open). ``field_deg`` is that of a square
    ``layout``. What is not known of a captured sky is NaN, or None for the seed.
    """

    file: str
    day: str
    time: str
    split: Split | None = None
    regime: str
    sun_zenith_deg: float
    sun_azimuth_deg: float = math.nan
    map_azimuth_deg: float
    sun_transmittance: float
    latitude_deg: float = math.nan
    longitude_deg: float = math.nan
    seed: int | None = None
    layout: Layout = "skylatlong"
    field_deg: float = math.nan


COLUMNS = tuple(f.name for f in fields(SkyRecord))
_NUMBERS = tuple(f.name for f in fields(SkyRecord) if f.type is float)


def read_index(place: Path) -> list[SkyRecord]:
    """The records of an index: ``place`` is its file, or a folder with an ``index.csv``.

    Raises :class:`InputError` for a file that is missing, no index, or empty, and for one whose
    days are not divided or fall to two splits.
    """
    path = place / INDEX_NAME if place.is_dir() or not place.suffix else place
    if not path.is_file():
        raise InputError(
            f"{path}: no index of skies there; `skylight skies simulate --out {place}` makes "
            f"skies, `skylight skies index {place}` indexes a folder of captured ones"
        )
    records = read_rows(path)
    if not records:
        raise InputError(f"{path}: the index has no rows")
    splits: dict[str, set[Split | None]] = {}
    for record in records:
        splits.setdefault(record.day, set()).add(record.split)
    for day, found in splits.items():
        if None in found:
            raise InputError(
                f"{path}: day {day} has no split; write {', '.join(get_args(Split))} into that "
                "column, or let `skylight skies index` do it"
            )
        if len(found) > 1:
            raise InputError(f"{path}: day {day} is in two splits; give all its skies the same one")
    return records


def is_index(path: Path) -> bool:
    """Whether a file's first row names the columns of an index of skies."""
    try:
        with path.open(newline="") as stream:
            head = next(csv.reader(stream), [])
    except (OSError, UnicodeDecodeError, csv.Error):
        return False
    return tuple(head) == COLUMNS


def map_path(place: Path, record: SkyRecord) -> Path:
    """Where a record's map lies; ``place`` is the index's file or its folder."""
    return (place.parent if place.is_file() else place) / record.file


def folder_hash(place: Path, records: list[SkyRecord]) -> str:
    """SHA-256 over the records and the bytes of their maps: names a data set exactly."""
    digest = hashlib.sha256()
    for record in records:
        digest.update(repr(record).encode())
        path = map_path(place, record)
        try:
            digest.update(path.read_bytes())
        except OSError as error:
            raise InputError(
                f"{path}: in the index but not readable ({error.strerror}); "
                "bring the map back or index the folder again"
            ) from error
    return digest.hexdigest()


def read_rows(path: Path) -> list[SkyRecord]:
    """The rows of an index, or of a part of one, whose days need no split yet."""
    try:
        rows = list(csv.DictReader(StringIO(file_text(path), newline="")))
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as an index of skies ({error})") from error
    try:
        return [_parse(row) for row in rows]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        if rows and "day" not in rows[0]:
            raise InputError(
                f"{path}: an index of another kind (columns {', '.join(map(str, rows[0]))}); index "
                f"its maps with: skylight skies index {path.parent} --out "
                f"{path.with_name('skies.csv')}"
            ) from error
        raise InputError(
            f"{path}: not an index of skies ({error}); its columns are {', '.join(COLUMNS)}"
        ) from error


def write_rows(path: Path, records: list[SkyRecord]) -> None:
    """Write records as CSV, whole or not at all; what is not known stays empty."""
    with atomic_path(path) as temporary, temporary.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, COLUMNS)
        writer.writeheader()
        for record in records:
            row = asdict(record)
            writer.writerow({k: "" if v is None or v != v else v for k, v in row.items()})


def counts(records: Sequence[SkyRecord]) -> str:
    """How many skies, days, and skies of each split."""
    found = Counter(record.split for record in records)
    days = len({record.day for record in records})
    splits = ", ".join(f"{found[split]} {split}" for split in get_args(Split))
    return f"{len(records)} skies of {days} day(s) ({splits})"


def _parse(row: dict[str, Any]) -> SkyRecord:
    values: dict[str, Any] = {c: row[c] for c in COLUMNS}
    if any(value is None for value in values.values()):
        raise ValueError("a row is too short")
    for column in _NUMBERS:
        unknown = values[column] == "" and column in _MAY_BE_EMPTY
        values[column] = math.nan if unknown else float(values[column])
        if not unknown and not math.isfinite(values[column]):
            raise ValueError(f"{column} is {row[column]}")
    values["seed"] = int(values["seed"]) if values["seed"] else None
    values["split"] = values["split"] or None
    for column, allowed in (("split", (*get_args(Split), None)), ("layout", get_args(Layout))):
        if values[column] not in allowed:
            raise ValueError(f"unknown {column} {values[column]!r}")
    return SkyRecord(**values)


def assign_splits(
    records: Sequence[SkyRecord],
    *,
    seed: int,
    tolerance: float = 0.05,
) -> dict[str, Split]:
    """The split of each day: the first of at most :data:`TRIES` random draws that is near enough.

    A draw puts the days into a random order and cuts it into test, validation and training
    days. It is near enough where, for each split, both its share of all skies is within
    ``tolerance`` of :data:`SHARES`, and its share of sunny skies within ``tolerance`` of that of
    all skies. Each split gets at least one day.

    The same records, in any order, and the same seed give the same days.

    Raises :class:`InputError` where no draw is near enough, naming the best one's distance.
    """
    names = sorted({r.day for r in records})
    if len(names) < len(SHARES):
        raise InputError(
            f"{len(names)} day(s) cannot be divided into {len(SHARES)} sets without a day in two "
            "of them: add days"
        )
    number = {name: i for i, name in enumerate(names)}
    skies = np.zeros((len(names), 2))  # of each day: sunny, others
    for record in records:
        skies[number[record.day], int(record.sun_transmittance < SUNNY)] += 1
    rng = np.random.default_rng(seed)
    best = math.inf
    for _ in range(TRIES):
        order = rng.permutation(len(names))
        sets = _cut(order, skies.sum(1))
        distance = _distance(sets, skies)
        if distance <= tolerance:
            splits = zip(get_args(Split), sets, strict=True)
            return {names[i]: split for split, days in splits for i in days}
        best = min(best, distance)
    raise InputError(
        f"no division of the {len(names)} days into training, validation and test days was within "
        f"{tolerance:g} of shares of {', '.join(f'{s:g}' for s in SHARES)} with the same part of "
        f"sunny skies; the best of {TRIES} draws was within {best:.2f}: add days or allow more"
    )


def divide(records: Sequence[SkyRecord], *, tolerance: float | None = None) -> list[SkyRecord]:
    """The records with their splits: 8 in 10 skies to train on, 1 in 10 each for the others.

    The default tolerance is 0.05, or 10 / days where the days are fewer than 200, since a set of
    k days meets a mixture only to about 1 / k. One or two days cannot be divided: they are
    training days.
    """
    days = len({r.day for r in records})
    if days < len(SHARES):
        return [replace(r, split="train") for r in records]
    tolerance = max(0.05, 10 / days) if tolerance is None else tolerance
    splits = assign_splits(records, seed=_SEED, tolerance=tolerance)
    return [replace(r, split=splits[r.day]) for r in records]


def _cut(order: NDArray[np.int64], skies: Float[np.ndarray, " d"]) -> list[NDArray[np.int64]]:
    """[train, validation, test] from an order of days, the nearest cuts to the shares of skies."""
    total = np.concatenate([[0.0], np.cumsum(skies[order])]) / skies.sum()
    cuts = [0]
    for left, share in ((2, SHARES[2]), (1, SHARES[1])):
        least, most = cuts[-1] + 1, len(order) - left  # the sets to come want a day each
        near = np.abs(total[least : most + 1] - total[cuts[-1]] - share)
        cuts.append(least + int(near.argmin()))
    test, validation, train = np.split(order, cuts[1:])
    return [train, validation, test]


def _distance(sets: list[NDArray[np.int64]], skies: Float[np.ndarray, "d 2"]) -> float:
    """The largest difference of a set's share of skies, or of its part of sunny ones."""
    every = skies.sum(0)
    worst = 0.0
    for days, share in zip(sets, SHARES, strict=True):
        found = skies[days].sum(0)
        worst = max(worst, abs(found.sum() / every.sum() - share))
        worst = max(worst, abs(found[0] / found.sum() - every[0] / every.sum()))
    return float(worst)


def centre_column_azimuth(height: int) -> float:
    """Azimuth of the middle of column w/2 of a sky map, where training wants the sun."""
    return math.pi / (4 * height)


def load_skies(
    place: Path, records: list[SkyRecord], *, height: int = 32
) -> Float[Tensor, "n h w 3"]:
    """The maps of ``records``: sun turned to the centre column, mean luminance 1.

    ``height`` x ``4 height`` upper hemispheres, float32, area-averaged from whichever layout
    they were captured in. ``place`` is the index's folder or file. Raises
    :class:`InputError` for a map that is missing, damaged or all black.
    """
    skies = []
    for record in records:
        path = map_path(place, record)
        sky = read_sky(path, record.layout, field_deg=record.field_deg).resize(height)
        if not sky.radiance.any():
            raise InputError(f"{path}: the map is all black; take it out of the index")
        skies.append(sky.radiance)
    azimuth = torch.tensor([math.radians(r.map_azimuth_deg) for r in records])
    return normalise(shift_columns(torch.stack(skies), centre_column_azimuth(height) - azimuth))


def normalise(skies: Float[Tensor, "n h w 3"]) -> Float[Tensor, "n h w 3"]:
    """Scale each sky, none of them black, to a mean luminance of 1 over the hemisphere."""
    height, width = skies.shape[1:3]
    solid = DirectionGrid.latlong(height, width).solid_angles.reshape(height, width)
    solid = solid.to(skies.device)
    mean = (luminance(skies).double() * solid).sum((1, 2)) / (2 * math.pi)
    return skies / mean.to(skies)[:, None, None, None]
