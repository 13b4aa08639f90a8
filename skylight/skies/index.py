"""The index of a folder of skies: ``index.csv``, and its hash."""

import csv
import hashlib
import math
from dataclasses import asdict, dataclass, fields
from io import StringIO
from pathlib import Path
from typing import Any, Literal, get_args

from skylight.errors import InputError
from skylight.io.atomic import atomic_path
from skylight.io.bounded import file_text
from skylight.io.collection import INDEX_NAME
from skylight.skies.layouts import Layout

Split = Literal["train", "validation", "test"]


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
_MAY_BE_EMPTY = ("sun_azimuth_deg", "latitude_deg", "longitude_deg", "field_deg")


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
