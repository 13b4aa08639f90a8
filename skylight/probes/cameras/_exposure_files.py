"""Exposures read from files with their EXIF times and lens, merged per view.

Pictures of 8 bits are codes, whose response may be recovered; RAW files, .exr and .hdr are linear
light, and pictures of 16 bits are made so by the response that is given, or sRGB.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import torch
from PIL import ExifTags

from skylight.errors import InputError
from skylight.imaging._colour import Decode
from skylight.imaging._exif import focal_length_px
from skylight.imaging._photo import RAW_SUFFIXES, read_codes, read_exif, read_light
from skylight.imaging._pictures import stored_picture
from skylight.io._hdr import SUFFIXES as HDR_SUFFIXES
from skylight.io._light import read_linear
from skylight.probes.cameras._exposures import (
    Choice,
    Exposure,
    ExposureSeries,
    Merged,
    linearised,
    merge,
)
from skylight.probes.cameras._response import Response, load_response

_FIXED = (ExifTags.Base.FNumber, ExifTags.Base.ISOSpeedRatings)
_PLATEAU = 5  # equal brightest pixels of a merged file that are no accident


def read_views(
    photos: Sequence[Path], second: Sequence[Path], times: str | None, response: str
) -> tuple[ExposureSeries, ...]:
    """One or two views, both in the unit of the first.

    ``times``: exposure times of ``photos`` and then of ``second``, or one list that serves both; by
    default EXIF data tell.
    ``response``: "auto", "srgb", "recover", or a file of `skylight camera response`. The second
    view gets the first one's.
    """
    given = None if times is None else exposure_times(times)
    if given is not None and len(given) == len(photos) == len(second):
        given = [*given, *given]
    if given is not None and len(given) != len(photos) + len(second):
        raise InputError(
            f"{len(given)} exposure times and {len(photos) + len(second)} pictures: give one each"
        )
    first = read_series(
        photos, None if given is None else given[: len(photos)], response_of(response)
    )
    if not second:
        return (first,)
    other = read_series(
        second, None if given is None else given[len(photos) :], first.merged.response or "auto"
    )
    if first.seconds is None or other.seconds is None:
        return first, other
    scaled = other.merged.radiance * (max(first.seconds) / max(other.seconds))
    return first, replace(other, merged=replace(other.merged, radiance=scaled))


def response_of(name: str) -> Response | Choice:
    """A choice of :func:`~skylight.probes.cameras._exposures.merge`, or that of a file."""
    if name in ("auto", "srgb", "recover"):
        return cast(Choice, name)
    return load_response(name)


def read_series(
    files: Sequence[Path],
    seconds: Sequence[float] | None,
    response: Response | Choice,
    *,
    lone: bool = False,
) -> ExposureSeries:
    """One view; ``seconds`` as EXIF data tell by default.

    ``lone`` allows for a single exposure, of which whatever is saturated stays unknown.
    """
    if not files:
        raise InputError("no pictures were given: name two exposures or more")
    stored = [path.suffix.lower() in HDR_SUFFIXES for path in files]
    if len(files) == 1 and stored[0]:
        merged = _merged_already(_read_linear(files[0]))
        return ExposureSeries(files=tuple(files), seconds=None, merged=merged, focal_px=None)
    if seconds is None and any(stored):
        raise InputError(f"{files[stored.index(True)]}: it tells no exposure time; give --times")
    images = [read_exposure(path, response) for path in files]
    if len(files) > 1 and seconds is None:
        seconds = exif_exposures(files)
    times = tuple(seconds) if seconds is not None else (1.0,)
    exposures = [
        Exposure(name=str(path), seconds=time, image=image)
        for path, time, image in zip(files, times, images, strict=True)
    ]
    merged = linearised(exposures[0], response) if lone else merge(exposures, response)
    height, width = images[0].shape[:2]
    focal_px = None if stored[0] else focal_length_px(read_exif(files[0]), width, height)
    return ExposureSeries(files=tuple(files), seconds=times, merged=merged, focal_px=focal_px)


def exposure_times(text: str) -> list[float]:
    """Seconds of a list such as "1/60,0.5,2"."""
    out = []
    for part in text.split(","):
        above, _, below = part.partition("/")
        try:
            value = float(above) / float(below or 1)
        except (ValueError, ZeroDivisionError):
            raise InputError(
                f"exposure times must be a list such as 1/60,1/30,0.5, got {text!r}"
            ) from None
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"exposure times must be above 0, got {part.strip()} in {text!r}")
        out.append(value)
    return out


def exif_exposures(paths: Sequence[Path]) -> list[float]:
    """Exposure times in seconds that the pictures' EXIF data tell."""
    seconds, settings = [], []
    for path in paths:
        tags = read_exif(path).get_ifd(ExifTags.IFD.Exif)
        seconds.append(float(tags.get(ExifTags.Base.ExposureTime, 0)))
        settings.append([tags.get(tag) for tag in _FIXED])
        if not seconds[-1] > 0:
            raise InputError(f"{path}: its EXIF data tell no exposure time; give --times")
        if settings[-1] != settings[0]:
            raise InputError(
                f"{path}: its aperture or ISO is not that of {paths[0]}: fix both and vary the time"
            )
    return seconds


def read_exposure(path: Path, response: Response | Choice) -> np.ndarray:
    """Codes of 8 bits, or linear light, (h,w,3)."""
    suffix = path.suffix.lower()
    if suffix in HDR_SUFFIXES:
        return _read_linear(path)
    if suffix in RAW_SUFFIXES:
        return _light_of(path, None)
    curve = response if isinstance(response, Response) else Response()
    with stored_picture(path) as picture:
        deep = picture.depth > 8
        if not deep and (response == "recover" or curve != Response()):
            return picture.codes()  # a curve of one's own is of the codes as they are
    if not deep:
        return read_codes(path)
    if curve.curve is not None or response == "recover":
        raise InputError(f"{path}: a recovered response is for 8 bits; export it with these")
    return _light_of(path, curve.gamma)


def _light_of(path: Path, decode: Decode | None) -> np.ndarray:
    """Linear light, 1 where a channel is saturated."""
    light, burnt = read_light(path, decode)
    largest = np.argmax(light, -1)[burnt]
    rows, columns = np.nonzero(burnt)
    light[rows, columns, largest] = np.maximum(light[rows, columns, largest], 1)
    return light


def _read_linear(path: Path) -> np.ndarray:
    pixels = read_linear(path)
    if not np.isfinite(pixels).all():
        raise InputError(f"{path}: it holds NaN or infinite pixels; repair or replace them")
    if not pixels.max() > 0:
        raise InputError(f"{path}: the picture is black; give another")
    # cameras' colour conversion leaves small negative values: colours outside Rec.709
    return pixels.clip(min=0)


def _merged_already(pixels: np.ndarray) -> Merged:
    """A flat plateau at the largest value says that the file was saturated there."""
    largest = pixels.max(-1)
    top = largest == largest.max()
    return Merged(
        radiance=torch.from_numpy(pixels),
        clipped=torch.from_numpy(top & (top.sum() >= _PLATEAU)),
        response=None,
        disagreement=None,
    )
