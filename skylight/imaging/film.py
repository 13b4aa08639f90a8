"""Films: decoded as they play, upright, each frame with its time."""

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from skylight.errors import InputError
from skylight.imaging.mp4 import HDR_TRANSFERS, transfer_characteristic
from skylight.io.bounded import PIXELS_MAX

FILM_SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm"})
USUAL_RATE = 30.0  # frames a second, where a file does not tell
# what FFmpeg prints of a damaged film says less than our message
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


@dataclass(frozen=True, kw_only=True)
class FilmFrame:
    """``codes`` (h,w,3), upright RGB of 8 bits, that are shown at ``time_s``.

    ``number`` counts the frames of the film from 0.
    """

    number: int
    time_s: float
    codes: UInt8[np.ndarray, "h w 3"]


@contextmanager
def opened_film(source: Path | int) -> Iterator[cv2.VideoCapture]:
    """A film, or the webcam of that number, as OpenCV reads it; turned as the file asks.

    Raises
    ------
    InputError
        It cannot be opened, its pictures are too large, or it is high dynamic range (PQ or HLG).
    """
    name = f"webcam {source}" if isinstance(source, int) else str(source)
    require_film(source)
    if isinstance(source, Path):
        transfer = HDR_TRANSFERS.get(transfer_characteristic(source) or 0)
        if transfer is not None:
            raise InputError(
                f"{source}: its codes are high dynamic range, {transfer}, which is not read; "
                "export it as SDR (Rec.709)"
            )
    # what OpenCV prints of a failure says less than our message
    log = cv2.utils.logging
    level = log.setLogLevel(log.LOG_LEVEL_SILENT)
    if isinstance(source, int):
        capture = cv2.VideoCapture(source)
    else:  # no other decoder of OpenCV's, which takes "film01.mp4" for a picture of many
        capture = cv2.VideoCapture(str(source), cv2.CAP_FFMPEG)
    log.setLogLevel(level)
    try:
        if not capture.isOpened():
            live = isinstance(source, int)
            mend = "see that it is plugged in and free" if live else "give a video such as .mp4"
            raise InputError(f"cannot open {name}: {mend}, or photographs")
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
        width = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        height = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        if width * height > PIXELS_MAX:
            raise InputError(f"{name}: {width}x{height} pixels are too many; scale it down")
        yield capture
    finally:
        capture.release()


def require_film(source: Path | int) -> None:
    """Refuse a video's file that is not there, and webcams below 0."""
    if isinstance(source, int):
        if source < 0:
            raise InputError(f"webcams are numbered from 0, got {source}")
    elif not source.is_file():
        raise InputError(f"cannot read {source}: there is no such file; give a video")


def film_rate(source: Path | int) -> float:
    """Frames a second that a video says it has; 30 where it does not, and for webcams."""
    if isinstance(source, int):
        return USUAL_RATE
    with opened_film(source) as capture:
        return _rate(capture)


def _rate(capture: cv2.VideoCapture) -> float:
    rate = float(capture.get(cv2.CAP_PROP_FPS))
    return rate if 1 <= rate <= 480 else USUAL_RATE


def told_length_s(source: Path) -> float | None:
    """How long a film's header says it is; None where it does not."""
    with opened_film(source) as capture:
        count = float(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        rate = float(capture.get(cv2.CAP_PROP_FPS))
    told = math.isfinite(count) and count > 0 and math.isfinite(rate) and rate > 0
    return count / rate if told else None


def film_frames(
    source: Path, *, most_a_second: float = math.inf, most_side: int | None = None
) -> Iterator[FilmFrame]:
    """The frames of a film as they play, of which ``most_a_second`` are given at most.

    Larger ones are scaled to ``most_side`` pixels on their longer side. Times are those at which
    frames are shown, whatever the rate is, from 0 on and never backwards.
    One frame is held at a time.

    Raises
    ------
    InputError
        As :func:`opened_film`, or no frame can be decoded.
    """
    with opened_film(source) as capture:
        step_s = 1 / _rate(capture)
        period_s = 1 / most_a_second
        number, first_s, last_s, due_s = 0, 0.0, -step_s, 0.0
        while capture.grab():
            shown_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
            first_s = shown_s if number == 0 else first_s
            # files without times: one step after the frame before
            time_s = shown_s - first_s
            last_s = time_s if number == 0 or time_s > last_s else last_s + step_s
            # half a step early is on time, so that rates which do not divide the film's are kept
            if last_s >= due_s - step_s / 2:
                good, bgr = capture.retrieve()
                if not good:
                    break
                due_s = due_s + period_s if due_s + period_s > last_s else last_s + period_s
                yield FilmFrame(
                    number=number, time_s=max(last_s, 0.0), codes=_scaled(as_rgb(bgr), most_side)
                )
            number += 1
        if number == 0:
            raise InputError(f"{source}: it holds no pictures; record it again")


def _scaled(
    codes: UInt8[np.ndarray, "h w 3"], most_side: int | None
) -> UInt8[np.ndarray, "h2 w2 3"]:
    height, width = codes.shape[:2]
    scale = 1.0 if most_side is None else most_side / max(height, width)
    if scale >= 1:
        return codes
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return np.asarray(cv2.resize(codes, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def as_rgb(picture: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    """What OpenCV decoded, grey or BGR, as RGB."""
    code = cv2.COLOR_GRAY2RGB if picture.ndim == 2 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(picture, code), dtype=np.uint8)
