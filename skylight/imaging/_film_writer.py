"""Films written: frame by frame, at one rate, beside their place and moved there when whole."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from skylight.errors import InputError, OutputError
from skylight.io._atomic import atomic_path

# MPEG-4 Part 2, the usual one first, and FFV1, which is lossless and about 40 times as large
CODES = {".mp4": "mp4v", ".mkv": "FFV1"}
WriteFrame = Callable[[UInt8[np.ndarray, "h w 3"]], None]


def check_film_name(path: Path) -> None:
    """Refuse, before any work, a film that :func:`written_film` could not write."""
    if path.suffix.lower() not in CODES:
        raise InputError(
            f"{path}: films are written as .mp4, or as .mkv without loss; choose another name"
        )


class _NotWriting(Exception):
    """What went wrong in the block, which is no failure of writing."""

    def __init__(self, error: OSError) -> None:
        super().__init__(str(error))
        self.error = error


@contextmanager
def written_film(path: Path, rate: float, size: tuple[int, int]) -> Iterator[WriteFrame]:
    """A function that writes RGB frames of ``size`` (width, height), ``rate`` a second, no sound.

    Both codecs take even sizes: the last column or row of others is there twice. An
    :class:`OSError` of the block, which may read another film, stays what it is.

    Raises
    ------
    OutputError
        No encoder, or not all frames are in the file: FFmpeg does not tell of a full disk.
    """
    check_film_name(path)
    try:
        with atomic_path(path) as temporary:
            yield from _written(path, temporary, rate, size)
    except _NotWriting as failure:
        raise failure.error from None


def _written(
    path: Path, temporary: Path, rate: float, size: tuple[int, int]
) -> Iterator[WriteFrame]:
    count, (width, height) = 0, size
    right, below = width % 2, height % 2
    code = cv2.VideoWriter.fourcc(*CODES[path.suffix.lower()])
    made = cv2.VideoWriter(
        str(temporary), cv2.CAP_FFMPEG, code, rate, (width + right, height + below)
    )
    if not made.isOpened():
        raise OutputError(f"cannot write a film to {path.parent}: choose another folder")

    def write(codes: UInt8[np.ndarray, "h w 3"]) -> None:
        nonlocal count
        bgr = cv2.cvtColor(codes, cv2.COLOR_RGB2BGR)
        made.write(cv2.copyMakeBorder(bgr, 0, below, 0, right, cv2.BORDER_REPLICATE))
        count += 1

    try:
        yield write
    except OSError as error:
        raise _NotWriting(error) from error
    finally:
        made.release()
    there = _frames_in(temporary)
    if there < count:
        raise OutputError(
            f"cannot write {path}: {there} of {count} frames are in it; free some space or "
            "choose another disk"
        )


def _frames_in(path: Path) -> int:
    """How many pictures can be taken from a film."""
    capture, count = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG), 0
    try:
        while capture.grab():
            count += 1
    finally:
        capture.release()
    return count
