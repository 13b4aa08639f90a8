"""Films: decoded as they play, upright, each frame with its time; HDR films are recognised."""

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
from skylight.imaging._film_headers import HDR_TRANSFERS, film_header
from skylight.io._bounded import PIXELS_MAX

FILM_SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm"})
_ASPECT_MOST = 8.0  # of pixels; real ones are below 3
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
    """A film, or the webcam of that number, as OpenCV reads it; turned as the file asks."""
    name = f"webcam {source}" if isinstance(source, int) else str(source)
    require_film(source)
    if isinstance(source, Path):
        transfer = HDR_TRANSFERS.get(film_header(source).transfer or 0)
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
    Pixels that are not square are made so.
    One frame is held at a time.

    Raises
    ------
    InputError
        As :func:`opened_film`, no frame can be decoded, or the decoder fails at fields.
    """
    with opened_film(source) as capture:
        step_s = 1 / _rate(capture)
        period_s = 1 / most_a_second
        shape = _pixel_shape(capture, source)
        still = _Still(source)
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
                still.see(bgr)
                due_s = due_s + period_s if due_s + period_s > last_s else last_s + period_s
                yield FilmFrame(
                    number=number,
                    time_s=max(last_s, 0.0),
                    codes=scaled(as_rgb(bgr), most_side, shape),
                )
            number += 1
        if number == 0:
            code = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode("latin-1")
            raise InputError(
                f"{source}: no picture of it can be decoded (codec {code}); export it as H.264"
            )
        still.end(number)


_ALIKE = 12  # so many frames alike of a film that may have fields are the decoder's failure


class _Still:
    """Tells a decoder that gives the same memory again and again, since it converts no fields.

    OpenCV reports such frames as good. Not every codec's header tells of fields (DV, ProRes, MPEG-2
    and MPEG-4 do not here); of these a film that stands still to its end is refused as well.
    """

    def __init__(self, source: Path) -> None:
        self._source = source
        self._interlaced = film_header(source).interlaced
        self._wanted = self._interlaced is not False
        self._first: np.ndarray | None = None
        self._alike = 0

    def see(self, bgr: np.ndarray) -> None:
        if not self._wanted:
            return
        if self._first is None:
            self._first = bgr.copy()
        self._wanted = np.array_equal(self._first, bgr)
        self._alike += 1
        if self._interlaced and self._alike == _ALIKE:
            self.end(_ALIKE)

    def end(self, frames: int) -> None:
        """After so many frames of the film, of which some were seen."""
        if not self._wanted or (self._interlaced is None and frames < _ALIKE):
            return
        if self._interlaced:
            reason = "it is interlaced, which is not decoded here"
        else:
            reason = "its frames are all alike, as those of interlaced films are decoded here"
        raise InputError(f"{self._source}: {reason}; export it deinterlaced (progressive H.264)")


def _pixel_shape(capture: cv2.VideoCapture, source: Path) -> tuple[float, float]:
    """How much wider, and how much higher, the pixels of an upright frame are shown."""
    told = [capture.get(each) for each in (cv2.CAP_PROP_SAR_NUM, cv2.CAP_PROP_SAR_DEN)]
    if min(told) <= 0:
        return 1.0, 1.0
    aspect = told[0] / told[1]
    if not 1 / _ASPECT_MOST <= aspect <= _ASPECT_MOST:
        raise InputError(f"{source}: pixels {aspect:.3g} times as wide as high; export it anew")
    turned = int(capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 180 != 0
    return (1.0, aspect) if turned else (aspect, 1.0)


def scaled(
    codes: UInt8[np.ndarray, "h w 3"],
    most_side: int | None,
    shape: tuple[float, float] = (1.0, 1.0),
) -> UInt8[np.ndarray, "h2 w2 3"]:
    """At most so many pixels on the longer side, where pixels are of that ``shape`` (w, h)."""
    height, width = codes.shape[0] * shape[1], codes.shape[1] * shape[0]
    scale = 1.0 if most_side is None else min(1.0, most_side / max(height, width))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    if size == codes.shape[1::-1]:
        return codes
    if scale == 1:
        return np.asarray(cv2.resize(codes, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
    return np.asarray(cv2.resize(codes, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def as_rgb(picture: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    """What OpenCV decoded, grey or BGR, as RGB."""
    code = cv2.COLOR_GRAY2RGB if picture.ndim == 2 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(picture, code), dtype=np.uint8)
