"""What a camera's EXIF data tell: focal length, flash, exposure, time, place and heading."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta, timezone
from pathlib import Path

from PIL import ExifTags, Image

from skylight.errors import InputError
from skylight.imaging._capture_metadata import CaptureMetadata
from skylight.imaging._exposure import CameraExposure
from skylight.io._bounded import file_bytes

FULL_FRAME_DIAGONAL_MM = math.hypot(36.0, 24.0)
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}  # EXIF 2.32, FocalPlaneResolutionUnit
# A phone's compass, near metal at times; and one that shows magnetic north, from which the true
# one differs by up to about 20 degrees where most people live.
TRUE_HEADING_ERROR_DEG, MAGNETIC_HEADING_ERROR_DEG = 15.0, 20.0
EXPOSURE_VALUES = -6.0, 20.0  # from starlight to sunlit snow, and beyond by some stops
_TIFF = (b"II*\0", b"MM\0*")
_OFFSET = re.compile(r"([+-])(\d{2}):(\d{2})")
_FARTHEST_OFFSET = timedelta(hours=14)  # of all zones in use


@dataclass(frozen=True, kw_only=True)
class CameraFacts:
    """``focal_px`` in pixels of the picture, ``flash``: whether it fired; None where unknown."""

    focal_px: float | None = None
    flash: bool | None = None
    camera_exposure: CameraExposure | None = None
    taken: CaptureMetadata | None = None


def camera_facts(exif: Image.Exif, width: int, height: int) -> CameraFacts:
    """All that the EXIF data of a ``width`` x ``height`` picture tell."""
    taken = taken_from(exif)
    return CameraFacts(
        focal_px=focal_length_px(exif, width, height),
        flash=flash_fired(exif),
        camera_exposure=camera_exposure(exif),
        taken=None if taken.is_nothing else taken,
    )


def focal_length_px(exif: Image.Exif, width: int, height: int) -> float | None:
    """Focal length in pixels of a ``width`` x ``height`` picture, from its EXIF data.

    From the 35 mm equivalent, which compares diagonals (CIPA DCG-001-2018)::

        f = f35 hypot(w, h) / hypot(36, 24)

    else from the focal length and the sensor's pixels per unit length. None where neither is
    there, or where the recorded picture size has another shape: the picture was cropped.
    """
    tags = exif.get_ifd(ExifTags.IFD.Exif)
    recorded = _positive(tags, "ExifImageWidth"), _positive(tags, "ExifImageHeight")
    full_long, long = max(width, height), max(width, height)
    if recorded[0] and recorded[1]:
        full_long = max(recorded[0], recorded[1])
        aspect = full_long / min(recorded[0], recorded[1])
        if abs(aspect / (long / min(width, height)) - 1) > 0.01:
            return None
    equivalent_mm = _positive(tags, "FocalLengthIn35mmFilm")
    if equivalent_mm:
        return equivalent_mm * math.hypot(width, height) / FULL_FRAME_DIAGONAL_MM
    focal_mm = _positive(tags, "FocalLength")
    per_unit = _positive(tags, "FocalPlaneXResolution")
    unit_mm = _MM_PER_UNIT.get(tags.get(ExifTags.Base.FocalPlaneResolutionUnit, 2))
    if focal_mm and per_unit and unit_mm:
        return focal_mm * per_unit / unit_mm * (long / full_long)
    return None


def flash_fired(exif: Image.Exif) -> bool | None:
    """Bit 0 of the Flash tag (EXIF 2.32); None without it."""
    value = exif.get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.Flash)
    return bool(value & 1) if isinstance(value, int) else None


def camera_exposure(exif: Image.Exif) -> CameraExposure | None:
    """Exposure time, f-number and sensitivity (the first, where there are several).

    None where one of them is missing, and where no picture of a person is so dark or bright.
    """
    tags = exif.get_ifd(ExifTags.IFD.Exif)
    seconds, aperture = _positive(tags, "ExposureTime"), _positive(tags, "FNumber")
    (sensitivity, *_) = _numbers(tags.get(ExifTags.Base.ISOSpeedRatings)) or [math.nan]
    # 65535 stands for all that is more (EXIF 2.32)
    if seconds is None or aperture is None or not 0 < sensitivity < 65535:
        return None
    exposure = CameraExposure(seconds=seconds, aperture=aperture, iso=sensitivity)
    return exposure if EXPOSURE_VALUES[0] <= exposure.value <= EXPOSURE_VALUES[1] else None


def taken_from(exif: Image.Exif) -> CaptureMetadata:
    """Time, place and heading.

    The satellites' time (UTC) counts where there is one, else the camera's clock, in its zone
    where OffsetTimeOriginal tells it. What cannot be is left out, with a note that does not
    repeat it: notes go into results, and places and times are private.
    """
    tags, gps = exif.get_ifd(ExifTags.IFD.Exif), exif.get_ifd(ExifTags.IFD.GPSInfo)
    notes: list[str] = []
    time = _satellite_time(gps, notes) or _clock_time(tags, notes)
    latitude_deg, longitude_deg = _place(gps, notes) or (None, None)
    heading_deg = _heading(gps, notes)
    reference = exif_text(gps.get(ExifTags.GPS.GPSImgDirectionRef))
    return CaptureMetadata(
        time=time,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        heading_deg=heading_deg,
        heading_error_deg=(
            TRUE_HEADING_ERROR_DEG if reference == "T" else MAGNETIC_HEADING_ERROR_DEG
        ),
        notes=tuple(notes),
    )


def _satellite_time(gps: Mapping[int, object], notes: list[str]) -> datetime | None:
    day = exif_text(gps.get(ExifTags.GPS.GPSDateStamp))
    clock = _numbers(gps.get(ExifTags.GPS.GPSTimeStamp))
    if not day or clock is None:
        return None
    try:
        if len(clock) != 3 or not (0 <= clock[0] < 24 and 0 <= clock[1] < 60 and clock[2] < 61):
            raise ValueError("no time of day")
        year, month, number = (int(part) for part in day.split(":"))
        begun = datetime.combine(date(year, month, number), datetime.min.time(), UTC)
        seconds = 3600 * clock[0] + 60 * clock[1] + clock[2]
        return _possible(begun + timedelta(seconds=seconds))
    except (ValueError, OverflowError, InputError):
        notes.append("the satellites' time in its EXIF data is impossible and was ignored")
        return None


def _clock_time(tags: Mapping[int, object], notes: list[str]) -> datetime | None:
    text = exif_text(tags.get(ExifTags.Base.DateTimeOriginal))
    if not text.strip(" :"):  # blanks stand for an unknown time (EXIF 2.32)
        return None
    try:
        time = _possible(datetime.strptime(text, "%Y:%m:%d %H:%M:%S"))
    except (ValueError, InputError):
        notes.append("the time in its EXIF data is impossible and was ignored")
        return None
    zone = exif_text(tags.get(ExifTags.Base.OffsetTimeOriginal))
    if zone == "Z":
        return time.replace(tzinfo=UTC)
    if not zone.strip(" :"):
        return time
    found = _OFFSET.fullmatch(zone)
    if found is not None:
        sign, hours, minutes = found.groups()
        offset = timedelta(hours=int(hours), minutes=int(minutes)) * (-1 if sign == "-" else 1)
        if abs(offset) <= _FARTHEST_OFFSET and int(minutes) < 60:
            return time.replace(tzinfo=timezone(offset))
    notes.append("the time zone in its EXIF data is impossible and was ignored")
    return time


def _possible(time: datetime) -> datetime:
    """The time itself; InputError in a year that cannot be."""
    CaptureMetadata(time=time)
    return time


def _place(gps: Mapping[int, object], notes: list[str]) -> tuple[float, float] | None:
    angles = []
    for value, reference, negative in (
        (ExifTags.GPS.GPSLatitude, ExifTags.GPS.GPSLatitudeRef, "S"),
        (ExifTags.GPS.GPSLongitude, ExifTags.GPS.GPSLongitudeRef, "W"),
    ):
        parts = _numbers(gps.get(value))
        if not parts:
            return None
        degrees = sum(part / unit for part, unit in zip(parts, (1, 60, 3600), strict=False))
        angles.append(-degrees if exif_text(gps.get(reference)).upper() == negative else degrees)
    if angles == [0, 0]:
        notes.append("the place 0, 0 in its EXIF data means that none was known: it was ignored")
        return None
    try:
        CaptureMetadata(latitude_deg=angles[0], longitude_deg=angles[1])
    except InputError:
        notes.append("the place in its EXIF data is impossible and was ignored")
        return None
    return angles[0], angles[1]


def _heading(gps: Mapping[int, object], notes: list[str]) -> float | None:
    parts = _numbers(gps.get(ExifTags.GPS.GPSImgDirection))
    if parts is None:
        return None
    try:
        return CaptureMetadata(heading_deg=parts[0]).heading_deg
    except (InputError, IndexError):
        notes.append("the heading in its EXIF data is impossible and was ignored")
        return None


def tiff_exif(path: Path) -> Image.Exif:
    """The EXIF data of a TIFF file, or of a RAW file that is built as one; none of others."""
    exif, content = Image.Exif(), file_bytes(path)
    if content.startswith(_TIFF):
        exif.load(b"Exif\0\0" + content)
    return exif


def _numbers(value: object) -> list[float] | None:
    """The number or numbers of a tag, NaN for what is no number; None where it is missing."""
    if value is None:
        return None
    parts = value if isinstance(value, Sequence) and not isinstance(value, str) else (value,)
    return [_number(part) for part in parts]


def _number(value: object) -> float:
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return math.nan


def exif_text(value: object) -> str:
    """A tag's text; none for a tag that is missing or of another kind."""
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    return value.strip("\0 ") if isinstance(value, str) else ""


def _positive(tags: Mapping[int, object], name: str) -> float | None:
    """The number of that EXIF tag, or None where it is missing, zero or no number."""
    value = _number(tags.get(ExifTags.Base[name], 0))
    return value if math.isfinite(value) and value > 0 else None
