"""Folders of captured skies: each map checked and dated, and an index of those that can be used.

A capture is dated by a list, its file's name or its file's header, in this order.
"""

import csv
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from io import StringIO
from pathlib import Path

import OpenEXR
import torch

from skylight.errors import InputError
from skylight.io._bounded import file_text
from skylight.io._files import names_categories, read_categories, visible_files
from skylight.io._hdr import SUFFIXES
from skylight.io._light import read_linear
from skylight.io._muted import muted
from skylight.skies._index import INDEX_NAME, SkyRecord, divide, is_index, read_rows, write_rows
from skylight.skies._layouts import FIELD_DEG, SQUARE, Layout, read_pixels, sky_of
from skylight.skies._sun import NO_SKY, PLATEAU_PIXELS, find_sun, plateau_size, why_no_sky
from skylight.work._progress import CountProgress

LEAST_ROWS = 32  # of a sky, as many as the models' skies have
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


@dataclass(frozen=True, kw_only=True)
class Refusal:
    """A map that is not used, and why, in words; ``is_sky``: because of a fault of its file."""

    file: str
    reason: str
    is_sky: bool = True

    def sentence(self) -> str:
        """For the user."""
        return f"{self.file}: {'refused' if self.is_sky else 'left out'}, {self.reason}"


def index_captures(
    folder: Path,
    *,
    layout: Layout | None = None,
    field_deg: float = FIELD_DEG,
    days: Path | None = None,
    all_maps: bool = False,
    progress: CountProgress | None = None,
) -> tuple[list[SkyRecord], list[Refusal]]:
    """Look at every .exr and .hdr map in ``folder`` and the folders in it; writes nothing.

    The records' files are relative to ``folder``, and their days not yet divided into splits.
    ``layout`` None tells it from each map's shape. ``days`` is a list for
    :func:`read_days`. ``sun_transmittance`` is 1 for a visible sun, else 0.

    Unless ``all_maps``, maps that show no sky are left out: those that an ``index.csv`` with the
    columns file and category calls indoor, studio or night, and those of :func:`why_no_sky`.

    Raises :class:`InputError` where there are no maps, the list names one that is not there, or
    an ``index.csv`` of the folder is damaged.
    """
    maps = visible_files(folder, SUFFIXES, recursive=True)
    files = sorted(path.relative_to(folder).as_posix() for path in maps)
    if not files:
        raise InputError(f"{folder}: no .exr or .hdr maps there to index")
    listed = read_days(days) if days else {}
    if absent := sorted(set(listed) - set(files)):
        raise InputError(f"{days}: lists {absent[0]}, which is not in {folder}; correct the list")
    categories = {} if all_maps else _categories(folder)
    records: list[SkyRecord] = []
    refusals: list[Refusal] = []
    for number, file in enumerate(files):
        if progress:
            progress(number, len(files))
        category = categories.get(file, "")
        if category.startswith(NO_SKY):
            reason = f"no sky above: {INDEX_NAME} calls it {category}"
            refusals.append(Refusal(file=file, reason=reason, is_sky=False))
            continue
        try:
            found = _look(folder, file, layout, field_deg)
            reason = None if all_maps else _no_sky(folder, found)
        except InputError as error:
            reason = str(error).removeprefix(f"{folder / file}: ")
            refusals.append(Refusal(file=file, reason=reason))
            continue
        if reason is not None:
            refusals.append(Refusal(file=file, reason=reason, is_sky=False))
            continue
        capture = capture_of(folder, file, listed)
        records.append(replace(found, day=capture.day, time=capture.time))
    return records, refusals


def index_folder(
    folder: Path,
    *,
    out: Path | None = None,
    layout: Layout | None = None,
    field_deg: float = FIELD_DEG,
    days: Path | None = None,
    tolerance: float | None = None,
    all_maps: bool = False,
    progress: CountProgress | None = None,
) -> tuple[Path, list[SkyRecord], list[Refusal]]:
    """Write an index of the usable maps of ``folder``; (the index, its records, what is refused).

    ``out`` is by default ``folder/index.csv``; in an index elsewhere the maps' paths are
    absolute. ``tolerance`` is that of :func:`divide`.

    Raises :class:`InputError` where no map can be used, and for an ``out`` that holds anything
    but an index of captured skies; that of a folder of simulated skies knows more than their
    maps show.
    """
    out = out or folder / INDEX_NAME
    if out.exists() and not is_index(out):
        raise InputError(
            f"{out}: is no index of skies of this version, and is not overwritten; write one "
            f"beside it with: skylight skies index {folder} --out {folder / 'skies.csv'}"
        )
    if out.exists() and any(record.seed is not None for record in read_rows(out)):
        raise InputError(
            f"{out}: indexes simulated skies, of which it knows more than their maps show; "
            "use it as it is, or name another file with --out"
        )
    records, refusals = index_captures(
        folder,
        layout=layout,
        field_deg=field_deg,
        days=days,
        all_maps=all_maps,
        progress=progress,
    )
    if not records:
        first = refusals[0]
        raise InputError(
            f"{folder}: none of its {len(refusals)} map(s) can be used; {first.file}: "
            f"{first.reason}"
        )
    if out.resolve().parent != folder.resolve():
        home = folder.resolve()
        records = [replace(r, file=(home / r.file).as_posix()) for r in records]
    records = divide(records, tolerance=tolerance)
    write_rows(out, records)
    return out, records, refusals


def describe(records: Sequence[SkyRecord], refusals: Sequence[Refusal]) -> Iterator[str]:
    """A line for each map: its day, split and sun, or why it is refused or left out."""
    for record in records:
        place = f"{90 - record.sun_zenith_deg:.0f} deg high at {record.map_azimuth_deg:+.0f} deg"
        sun = f"sun {place}" if record.sun_transmittance else f"no sun, brightest {place}"
        yield f"{record.file}: {record.layout}, day {record.day} ({record.split}), {sun}"
    for refusal in refusals:
        yield refusal.sentence()
    left_out = Counter(refusal.reason for refusal in refusals if not refusal.is_sky)
    for reason, count in left_out.most_common():
        yield f"{count} left out, {reason}"


def _categories(folder: Path) -> dict[str, str]:
    """File -> category of a folder whose index names them; nothing where there is no such index."""
    if is_index(folder / INDEX_NAME) or not names_categories(folder):
        return {}
    return read_categories(folder)


def _no_sky(folder: Path, record: SkyRecord) -> str | None:
    if record.layout != "latlong":  # maps of a sky alone show nothing to compare it with
        return None
    radiance = torch.from_numpy(read_linear(folder / record.file))
    return why_no_sky(radiance, sun_is_visible=record.sun_transmittance > 0)


def _look(folder: Path, file: str, layout: Layout | None, field_deg: float) -> SkyRecord:
    """What a map shows, its capture not yet known; :class:`InputError` says why it is unusable."""
    layout, pixels = read_pixels(folder / file, layout, field_deg=field_deg)
    square = layout in SQUARE
    rows = pixels.shape[0] // (2 if square else 1)
    if rows < LEAST_ROWS:
        raise InputError(f"too small: {rows} rows from zenith to horizon, at least {LEAST_ROWS}")
    if not pixels.any():
        raise InputError("the sky is all black")
    plateau = plateau_size(pixels, wraps=not square)
    if plateau >= PLATEAU_PIXELS:
        raise InputError(
            f"clipped: {plateau} pixels at its brightest place are equally bright, so the light "
            "of the sun is cut off; merge exposures that are short enough"
        )
    sun = find_sun(sky_of(pixels, layout, field_deg=field_deg))
    return SkyRecord(
        file=file,
        day="",
        time="",
        regime="clear" if sun.visible else "overcast",
        sun_zenith_deg=math.degrees(sun.zenith_rad),
        map_azimuth_deg=math.degrees(sun.azimuth_rad),
        sun_transmittance=float(sun.visible),
        layout=layout,
        field_deg=field_deg if square else math.nan,
    )
