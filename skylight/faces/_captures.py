"""Photographs of people with captured light probes: a folder with a ``captures.csv``.

A row a photograph (thesis, 5.4.2: 9 people under 25 lights)::

    photo,probe,azimuth_deg,visible_sun,person
    anna_noon.jpg,noon.exr,-47.8125,1,anna

``photo`` and ``probe`` are files within the folder, ``probe`` a lat-long HDR map of the whole
sphere. Rotated by ``azimuth_deg`` about the vertical, so that everything in it moves so far to the
right, its centre is where the camera of the photograph looks; empty where nobody knows it yet.
``visible_sun`` is 1 where the sun shone, 0 where clouds or houses hid it. Further columns are kept.
"""

import csv
import hashlib
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from io import StringIO
from pathlib import Path, PurePosixPath

from skylight.errors import InputError
from skylight.io._atomic import atomic_path
from skylight.io._bounded import file_text
from skylight.io._files import read_environment_map
from skylight.sphere._envmap import EnvironmentMap

CAPTURES_NAME = "captures.csv"
COLUMNS = ("photo", "probe", "azimuth_deg", "visible_sun", "person")
# Of the sphere's pixels: a sun with its glare covers less.
CLIPPED_SHARE = 2e-3


@dataclass(frozen=True, kw_only=True)
class FaceCapture:
    """One row: files relative to the folder, degrees to the right or None, who is in it."""

    photo: str
    probe: str
    azimuth_deg: float | None
    visible_sun: bool
    person: str


def read_captures(folder: Path) -> list[FaceCapture]:
    """The rows of ``folder/captures.csv`` in its order.

    Raises
    ------
    InputError
        No readable file with the columns :data:`COLUMNS`, no rows, a photograph that stands
        twice, a file that is not there, or a value that cannot be understood; with its line.
    """
    path = folder / CAPTURES_NAME
    lines: dict[str, int] = {}
    captures = []
    for number, row in _read_rows(path)[1]:
        try:
            capture = _parse(folder, row)
        except ValueError as error:
            raise InputError(f"{path}, line {number}: {error}") from error
        if capture.photo in lines:
            raise InputError(
                f"{path}, line {number}: {capture.photo} stands in line {lines[capture.photo]} "
                "already; leave one of them"
            )
        lines[capture.photo] = number
        captures.append(capture)
    return captures


def write_azimuths(folder: Path, azimuths_deg: Mapping[str, float]) -> None:
    """Fill in ``azimuth_deg`` of the photographs named; all else stays, also other columns."""
    path = folder / CAPTURES_NAME
    header, rows = _read_rows(path)
    unknown = set(azimuths_deg) - {row["photo"] for _, row in rows}
    if unknown:
        raise InputError(f"{path}: no photograph {', '.join(sorted(unknown))} there")
    for _, row in rows:
        if row["photo"] in azimuths_deg:
            row["azimuth_deg"] = f"{azimuths_deg[row['photo']]:.8g}"
    with (
        atomic_path(path) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as stream,
    ):
        writer = csv.DictWriter(stream, header, lineterminator="\n")
        writer.writeheader()
        writer.writerows(row for _, row in rows)


def read_probe(folder: Path, capture: FaceCapture) -> EnvironmentMap:
    """The probe as it lies in its file, not rotated."""
    path = folder / capture.probe
    probe = read_environment_map(path)
    if probe.is_sky:
        raise InputError(
            f"{path}: the map shows the upper half alone; a probe needs the whole sphere, twice "
            "as wide as high"
        )
    brightest = float(probe.radiance.max())
    if brightest <= 0:
        raise InputError(f"{path}: the map is black; capture the light again")
    clipped = int((probe.radiance == brightest).any(2).sum())
    if clipped > max(1, CLIPPED_SHARE * math.prod(probe.layout)):
        raise InputError(
            f"{path}: {clipped} of its pixels have the same greatest value, so the brightest "
            "light was cut off; merge shorter exposures into it"
        )
    return probe


def true_light(folder: Path, capture: FaceCapture, height: int = 64) -> EnvironmentMap:
    """The light that fell on the person, in the frame of the photograph's camera."""
    if capture.azimuth_deg is None:
        raise InputError(
            f"{capture.photo}: {folder / CAPTURES_NAME} has no azimuth_deg for it; find it by "
            f"`skylight faces calibrate-azimuth {folder}`"
        )
    probe = read_probe(folder, capture)
    return probe.rotate_azimuth(math.radians(capture.azimuth_deg)).resize(height)


def capture_hash(folder: Path, capture: FaceCapture) -> str:
    """SHA-256 over the bytes of photograph and probe."""
    digest = hashlib.sha256()
    for name in (capture.photo, capture.probe):
        content = _bytes(folder / name)
        digest.update(len(content).to_bytes(8, "little"))
        digest.update(content)
    return digest.hexdigest()


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error


def _read_rows(path: Path) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """(header, [(line, row)]) of a table that has all columns and at least a row."""
    try:
        # spreadsheets put a byte order mark first
        reader = csv.DictReader(StringIO(file_text(path, encoding="utf-8-sig"), newline=""))
        header = list(reader.fieldnames or ())
        rows = [(reader.line_num, row) for row in reader]
    except FileNotFoundError as error:
        raise InputError(
            f"{path}: no such file; write one with the columns {', '.join(COLUMNS)}"
        ) from error
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as a table of captures ({error})") from error
    missing = [column for column in COLUMNS if column not in header]
    if missing or len(set(header)) != len(header):
        fault = f"no column {', '.join(missing)}" if missing else "a column that stands twice"
        raise InputError(
            f"{path}: its first line has {fault}; it names {', '.join(COLUMNS)}, with commas"
        )
    for number, row in rows:
        if None in row or None in row.values():
            raise InputError(f"{path}, line {number}: not as many values as the first line names")
    if not rows:
        raise InputError(f"{path}: it has no rows; write one for each photograph")
    return header, rows


def _parse(folder: Path, row: dict[str, str]) -> FaceCapture:
    """A row; ValueError says what is wrong with it."""
    for column in ("photo", "probe"):
        inside = PurePosixPath(row[column])
        if not row[column] or inside.is_absolute() or ".." in inside.parts:
            raise ValueError(f"{column} is {row[column]!r}; it must be a file within {folder}")
        if not os.path.isfile(folder / row[column]):  # Path's raises for names that cannot be
            raise ValueError(f"{column} {row[column]!r} is not there")
    if row["visible_sun"] not in ("0", "1"):
        raise ValueError(f"visible_sun is {row['visible_sun']!r}; it must be 0 or 1")
    if not row["person"]:
        raise ValueError("person is empty; name whoever is in the photograph")
    return FaceCapture(
        photo=row["photo"],
        probe=row["probe"],
        azimuth_deg=_degrees(row["azimuth_deg"]) if row["azimuth_deg"] else None,
        visible_sun=row["visible_sun"] == "1",
        person=row["person"],
    )


def _degrees(text: str) -> float:
    wrong = ValueError(f"azimuth_deg is {text!r}; it must be empty or from -360 to 360 degrees")
    try:
        value = float(text)
    except ValueError:
        raise wrong from None
    if not abs(value) <= 360:  # also NaN
        raise wrong
    return value
