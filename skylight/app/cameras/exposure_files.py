"""Exposures read from files with their EXIF times and lens, merged per view."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, cast

import numpy as np
import torch

from skylight.app.cameras.calibration import exif_exposures, exposure_times
from skylight.cameras.frames import read_picture
from skylight.cameras.response import Response, load_response
from skylight.errors import InputError
from skylight.imaging.exif import focal_length_px
from skylight.io.hdr import SUFFIXES as HDR_SUFFIXES
from skylight.io.hdr import read_linear
from skylight.io.opened_picture import opened_picture
from skylight.probes.radiance.exposures import Exposure, ExposureSeries, Merged, merge

_PLATEAU = 5  # equal brightest pixels of a merged file that are no accident


def read_views(
    photos: Sequence[Path], second: Sequence[Path], times: str | None, response: str
) -> tuple[ExposureSeries, ...]:
    """One or two views, both in the unit of the first.

    Parameters
    ----------
    times
        Exposure times of ``photos`` and then of ``second``, or one list that serves both; by
        default EXIF data tell.
    response
        "auto", "srgb", "recover", or a file of `skylight camera response`. The second view gets
        the first one's.

    Raises
    ------
    InputError
        Files that cannot be read, that have no times, or that do not belong together.
    """
    given = None if times is None else exposure_times(times)
    if given is not None and len(given) == len(photos) == len(second):
        given = [*given, *given]
    if given is not None and len(given) != len(photos) + len(second):
        raise InputError(
            f"{len(given)} exposure times and {len(photos) + len(second)} pictures: give one each"
        )
    first = _read(photos, None if given is None else given[: len(photos)], _response(response))
    if not second:
        return (first,)
    other = _read(second, None if given is None else given[len(photos) :], first.merged.response)
    if first.seconds is None or other.seconds is None:
        return first, other
    scaled = other.merged.radiance * (max(first.seconds) / max(other.seconds))
    return first, replace(other, merged=replace(other.merged, radiance=scaled))


def _response(
    name: str,
) -> Response | Literal["auto", "srgb", "recover"]:
    if name in ("auto", "srgb", "recover"):
        return cast(Literal["auto", "srgb", "recover"], name)
    return load_response(name)


def _read(
    files: Sequence[Path],
    seconds: Sequence[float] | None,
    response: Response | Literal["auto", "srgb", "recover"] | None,
) -> ExposureSeries:
    if not files:
        raise InputError("no pictures were given: name two exposures or more")
    linear = [path.suffix.lower() in HDR_SUFFIXES for path in files]
    if len(files) == 1 and linear[0]:
        merged = _merged_already(_read_linear(files[0]))
        return ExposureSeries(files=tuple(files), seconds=None, merged=merged, focal_px=None)
    if seconds is None and any(linear):
        raise InputError(f"{files[linear.index(True)]}: it tells no exposure time; give --times")
    images = [
        _read_linear(path) if is_linear else read_picture(path).image
        for path, is_linear in zip(files, linear, strict=True)
    ]
    if len(files) > 1 and seconds is None:
        seconds = exif_exposures(files)
    times = tuple(seconds) if seconds is not None else (1.0,)  # one picture, which is refused
    exposures = [
        Exposure(name=str(path), seconds=time, image=image)
        for path, time, image in zip(files, times, images, strict=True)
    ]
    merged = merge(exposures, "auto" if response is None else response)
    focal_px = None if linear[0] else _focal_px(files[0])
    return ExposureSeries(files=tuple(files), seconds=times, merged=merged, focal_px=focal_px)


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


def _focal_px(path: Path) -> float | None:
    with opened_picture(path) as image:
        return focal_length_px(image.getexif(), *image.size)
