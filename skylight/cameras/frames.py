"""Frames from photographs, from the sharp frames of a video, or from a webcam."""

import math
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from PIL import ExifTags, ImageOps

from skylight.errors import InputError
from skylight.imaging.film import as_rgb, film_frames, opened_film
from skylight.io.opened_picture import opened_picture

FRAMES_MOST = 40
WEBCAM_SECONDS = 20.0
_WINDOW = 10  # frames of which the sharpest is taken: a third of a second of most videos
# codes, mean over a thumbnail: noise makes 0.02, a board tilted by 15 degrees at 80 cm 1.5
_DIFFERENT = 1.0
_THUMBNAIL = (48, 32)


@dataclass(frozen=True, kw_only=True)
class Frame:
    """A picture, RGB, what to call it in messages, and the EXIF orientation it was turned by."""

    name: str
    image: UInt8[np.ndarray, "h w 3"]
    orientation: int = 1


@dataclass(frozen=True, kw_only=True)
class _Candidate:
    frame: Frame
    sharpness: float
    thumbnail: Float[np.ndarray, "h w"]


def read_frames(
    source: Path | Sequence[Path] | int,
    *,
    most: int = FRAMES_MOST,
    seconds: float = WEBCAM_SECONDS,
) -> Iterator[Frame]:
    """Pictures of one size.

    Parameters
    ----------
    source
        A list of photographs, all of which are given; a video, or the number of a webcam, of
        which come at most ``most`` frames, each the sharpest of its ten and different from others.
    seconds
        How long a webcam is watched.

    Raises
    ------
    InputError
        A file or camera that cannot be opened or has no pictures; several sizes, or photographs
        for which the camera was held in several ways.
    """
    if isinstance(source, Sequence):
        if not source:
            raise InputError("no pictures were given: name one or more files")
        return _one_size(map(read_picture, source))
    if isinstance(source, int) and source < 0:
        raise InputError(f"webcams are numbered from 0, got {source}")
    return _one_size(sharp_and_different(film(source, seconds=seconds), most=most))


def read_picture(path: Path) -> Frame:
    """A photograph as 8-bit RGB, upright as its EXIF orientation asks; grey is welcome.

    Raises
    ------
    InputError
        The file is missing, damaged or no 8-bit picture.
    """
    with opened_picture(path) as image:
        orientation = int(image.getexif().get(ExifTags.Base.Orientation, 1))
        if image.mode in ("I", "F") or image.mode.startswith("I;"):
            raise InputError(f"{path}: its values have more than 8 bits; export it with 8")
        upright = np.array(ImageOps.exif_transpose(image).convert("RGB"))
    return Frame(name=str(path), image=upright, orientation=orientation)


def sharp_and_different(frames: Iterable[Frame], *, most: int) -> Iterator[Frame]:
    """At most ``most`` frames: the sharpest of every ten that differs from those kept.

    Sharpness is the variance of the Laplacian (Pech-Pacheco et al. 2000), difference the mean
    over a small grey picture. Where there are too many, one of the two most alike goes, so that
    the whole film stays covered; no more than ``most`` frames are held in memory.
    """
    kept: list[_Candidate] = []
    best: _Candidate | None = None
    for number, frame in enumerate(frames):
        candidate = _judged(frame)
        if best is None or candidate.sharpness > best.sharpness:
            best = candidate
        if number % _WINDOW == _WINDOW - 1:
            _keep(kept, best, most)
            best = None
    if best is not None:
        _keep(kept, best, most)
    median = float(np.median([each.sharpness for each in kept])) if kept else 0.0
    # a window of motion blur has no sharp frame at all
    return (each.frame for each in kept if each.sharpness >= 0.2 * median)


def _keep(kept: list[_Candidate], new: _Candidate, most: int) -> None:
    """Add the candidate where it is unlike all others; make room by what is most alike."""
    for i, other in enumerate(kept):
        if _difference(new, other) < _DIFFERENT:
            if new.sharpness > other.sharpness:
                kept[i] = new
            return
    kept.append(new)
    if len(kept) > most:
        pairs = [
            (_difference(a, b), i if a.sharpness < b.sharpness else j)
            for i, a in enumerate(kept)
            for j, b in enumerate(kept[:i])
        ]
        del kept[min(pairs)[1]]


def _judged(frame: Frame) -> _Candidate:
    grey = cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY)
    small = cv2.resize(grey, _THUMBNAIL, interpolation=cv2.INTER_AREA).astype(np.float32)
    return _Candidate(
        frame=frame,
        sharpness=float(cv2.Laplacian(grey, cv2.CV_32F).var()),
        thumbnail=small - small.mean(),  # exposure control is no new view
    )


def _difference(a: _Candidate, b: _Candidate) -> float:
    return float(np.abs(a.thumbnail - b.thumbnail).mean())


def film(source: Path | int, *, seconds: float = math.inf) -> Iterator[Frame]:
    """Every frame of a video; of a webcam (its number), those of ``seconds``.

    Raises
    ------
    InputError
        A film that cannot be opened or has no pictures.
    """
    if isinstance(source, Path):
        for frame in film_frames(source):
            yield Frame(name=f"{source}, frame {frame.number + 1}", image=frame.codes)
        return
    name = f"webcam {source}"
    with opened_film(source) as capture:
        number, stop = 0, time.monotonic() + seconds
        while time.monotonic() < stop:
            good, bgr = capture.read()
            if not good:
                break
            number += 1
            yield Frame(name=f"{name}, frame {number}", image=as_rgb(bgr))
        if number == 0:
            raise InputError(f"{name}: it holds no pictures; record it again")


def _one_size(frames: Iterable[Frame]) -> Iterator[Frame]:
    """The same frames; refuses one that differs in size or orientation from the first."""
    first: Frame | None = None
    for frame in frames:
        first = first or frame
        height, width = frame.image.shape[:2]
        if frame.image.shape != first.image.shape:
            was_height, was_width = first.image.shape[:2]
            raise InputError(
                f"{frame.name}: {width}x{height} pixels, but {first.name} has "
                f"{was_width}x{was_height}; take all in one size and one way of holding the camera"
            )
        # upside down, the size is the same and the principal point is mirrored
        if frame.orientation != first.orientation:
            raise InputError(
                f"{frame.name}: the camera was held another way than for {first.name}; keep to one"
            )
        yield frame
