"""Capture dates of skies, from a list, file names or headers."""

import csv
import re
from dataclasses import dataclass
from datetime import datetime
from io import StringIO
from pathlib import Path

import OpenEXR

from skylight.errors import InputError
from skylight.io.bounded import file_text
from skylight.io.hdr import muted

_SEPARATOR = r"[-_.: ]?"
_DATE = re.compile(
    rf"(?<!\d)((?:19|20)\d\d){_SEPARATOR}(\d\d){_SEPARATOR}(\d\d)"
    rf"(?:[-_. T/]?(\d\d){_SEPARATOR}(\d\d)(?:{_SEPARATOR}(\d\d))?)?(?!\d)"
)


@dataclass(frozen=True, kw_only=True)
class Capture:
    """``day`` is what a split must not cut; ``time`` is local and as exact as known, or empty."""

    day: str
    time: str = ""


def capture_of(folder: Path, file: str, listed: dict[str, Capture]) -> Capture:
    """When ``folder / file`` was captured: by the list, else the name, else the header.

    A map dated by none of them is a day of its own, named like the file.
    """
    if file in listed:
        return listed[file]
    found = parse_date(file) or parse_date(header_date(folder / file))
    return found or Capture(day=Path(file).with_suffix("").as_posix())


def parse_date(text: str) -> Capture | None:
    """The date in a text such as ``IMG_20160515_093000``, ``2016-05-15`` or ``20160515/093000``.

    Digits that are no date of the calendar do not count; of several dates the last one with a
    time counts, or else the last.
    """
    found: list[Capture] = []
    for match in _DATE.finditer(text):
        year, month, day, hour, minute, second = match.groups()
        try:
            date = datetime(int(year), int(month), int(day))
        except ValueError:
            continue
        clock = ""
        if hour and int(hour) < 24 and int(minute) < 60 and int(second or 0) < 60:
            clock = f"{date:%Y-%m-%d}T{hour}:{minute}:{second or '00'}"
        found.append(Capture(day=f"{date:%Y%m%d}", time=clock))
    timed = [capture for capture in found if capture.time]
    return (timed or found or [None])[-1]


def header_date(path: Path) -> str:
    """The capture date that a file's header gives, as it stands there, or an empty text.

    OpenEXR's standard attribute is ``capDate``, the Radiance format's is ``CAPDATE=``, both
    ``YYYY:MM:DD hh:mm:ss``.
    """
    if path.suffix.lower() == ".exr":
        try:
            with muted():
                return str(OpenEXR.File(str(path), header_only=True).header().get("capDate", ""))
        except (RuntimeError, IndexError, ValueError):
            return ""  # a damaged file, which reading its pixels reports
    try:
        with path.open("rb") as stream:
            head = stream.read(4096).partition(b"\n\n")[0].decode("latin-1")
    except OSError:
        return ""
    dates = re.findall(r"^CAPDATE=\s*(.*)$", head, re.MULTILINE)
    return dates[-1] if dates else ""


def read_days(path: Path) -> dict[str, Capture]:
    """The captures of a CSV list with the columns ``file``, ``day`` and, if known, ``time``.

    A day may have any name. Raises :class:`InputError` for a list that cannot be read, a row
    without a file or day, and a file that is listed twice.
    """
    try:
        reader = csv.DictReader(StringIO(file_text(path, encoding="utf-8-sig"), newline=""))
        rows = list(reader)
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as a list of capture days ({error})") from error
    if not rows and not {"file", "day"} <= set(reader.fieldnames or ()):
        raise InputError(f"{path}: its first line has no columns file and day; name them there")
    listed: dict[str, Capture] = {}
    for number, row in enumerate(rows, start=2):
        file, day = ((row.get(name) or "").strip() for name in ("file", "day"))
        if not file or not day:
            raise InputError(
                f"{path}: row {number} has no file or no day; its columns are file,day or "
                "file,day,time"
            )
        if file in listed:
            raise InputError(f"{path}: row {number} lists {file} a second time; keep one row")
        listed[file] = Capture(day=day, time=(row.get("time") or "").strip())
    return listed
