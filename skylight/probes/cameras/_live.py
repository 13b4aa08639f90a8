"""Frames: read from photographs, a video or a webcam, and composited into live views and films."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from PIL import ExifTags

from skylight.errors import InputError
from skylight.imaging._film import as_rgb, film_frames, film_rate, opened_film, require_film
from skylight.imaging._film_writer import check_film_name, written_film
from skylight.imaging._photo import read_codes
from skylight.imaging._pictures import stored_picture
from skylight.io._atomic import require_place

FRAMES_MOST = 40
WEBCAM_SECONDS = 20.0  # for which one is watched
_WINDOW = 10  # frames of which the sharpest is taken: a third of a second of most videos
# codes, mean over a thumbnail: noise makes 0.02, a board tilted by 15 degrees at 80 cm 1.5
_DIFFERENT = 1.0
_THUMBNAIL = (48, 32)
_FRAME = "frame"


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


def read_frames(source: Path | Sequence[Path] | int, *, most: int = FRAMES_MOST) -> Iterator[Frame]:
    """Pictures of one size.

    ``source``: a list of photographs, all of which are given; a video, or the number of a webcam,
    of which come at most ``most`` frames, each the sharpest of its ten and different from others.
    """
    if isinstance(source, Sequence):
        if not source:
            raise InputError("no pictures were given: name one or more files")
        return _one_size(map(read_picture, source))
    return _one_size(sharp_and_different(film(source, seconds=WEBCAM_SECONDS), most=most))


def read_picture(path: Path) -> Frame:
    """A photograph as 8-bit sRGB, upright as its EXIF orientation asks; grey is welcome."""
    with stored_picture(path) as picture:
        orientation = picture.exif().get(ExifTags.Base.Orientation, 1)
    return Frame(name=str(path), image=read_codes(path), orientation=orientation)


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
    """Every frame of a video; of a webcam (its number), those of ``seconds``."""
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


@dataclass(frozen=True, kw_only=True)
class Times:
    """Seconds by the clock, and those of all processor cores together."""

    wall: float
    cpu: float


@dataclass(frozen=True, kw_only=True)
class LiveFrame:
    """A frame with the model in it, or as it came where that is not known yet.

    ``known`` counts what of the probe was captured so far; ``times`` are those of each stage that
    was reached.
    """

    picture: UInt8[np.ndarray, "h w 3"]
    tracked: bool
    known: int
    times: dict[str, Times]


class Clock:
    """Times of each stage, from mark to mark."""

    def __init__(self) -> None:
        self.times: dict[str, Times] = {}
        self._last = _now()

    def mark(self, stage: str) -> None:
        """The stage that began at the last mark ends here."""
        now = _now()
        self.times[stage] = Times(wall=now.wall - self._last.wall, cpu=now.cpu - self._last.cpu)
        self._last = now


def _now() -> Times:
    return Times(wall=time.perf_counter(), cpu=time.process_time())


Show = Callable[[UInt8[np.ndarray, "h w 3"]], LiveFrame]


@dataclass(frozen=True, kw_only=True)
class LiveReport:
    """Median milliseconds of each stage over the frames that reached it, and of whole frames.

    ``known`` is what of the probe was captured in the end. ``stage_ms`` goes by the clock,
    ``stage_cpu_ms`` sums over processor cores; the stages read and write are the film's, and
    ``frame_ms`` and ``frame_cpu_ms`` are without them.
    """

    frames: int
    tracked: int
    known: int
    stage_ms: dict[str, float]
    stage_cpu_ms: dict[str, float]
    frame_ms: float
    frame_cpu_ms: float

    @property
    def frames_per_s(self) -> float:
        """By the clock, without reading and writing films."""
        return 1000 / self.frame_ms

    def sentence(self, out: Path, known: str) -> str:
        """For the user; ``known`` says what is counted."""
        stages = ", ".join(f"{stage} {ms:.1f}" for stage, ms in self.stage_ms.items())
        return (
            f"{out}: {self.frames} frames, {self.tracked} tracked, {self.known} {known}; "
            f"{self.frames_per_s:.0f} frames/s (ms: {stages})"
        )


def check_film(source: Path | int, out: Path, most: int | None) -> None:
    """Refuse, before any work, what :func:`write_film` could not read or write."""
    check_film_name(out)
    if most is not None and most < 1:
        raise InputError(f"at least 1 frame is needed, got {most}")
    require_film(source)
    require_place(out)


def write_film(
    source: Path | int, out: Path, show: Show, *, size: tuple[int, int], most: int | None = None
) -> LiveReport:
    """Write ``out`` (.mp4, .mkv; ``size`` is width and height) with what each frame becomes.

    Ctrl-C ends a webcam's film, which is kept.
    """
    check_film(source, out, most)
    rate = film_rate(source)
    times: dict[str, list[Times]] = {}
    whole: list[Times] = []
    tracked = known = 0
    with written_film(out, rate, size) as write:
        started, written = perf_counter(), 0
        clock = Clock()
        try:
            for shot in film(source):
                clock.mark("read")
                frame = show(shot.image)
                clock.mark(_FRAME)
                # a webcam's frames last as long as they took
                late = round((perf_counter() - started) * rate) - written
                for _ in range(max(1, late) if isinstance(source, int) else 1):
                    write(frame.picture)
                    written += 1
                clock.mark("write")
                tracked, known = tracked + frame.tracked, frame.known
                whole.append(clock.times.pop(_FRAME))
                for stage, spent in {**frame.times, **clock.times}.items():
                    times.setdefault(stage, []).append(spent)
                if most is not None and len(whole) >= most:
                    break
        except KeyboardInterrupt:
            if isinstance(source, Path) or not whole:
                raise
        if not tracked:
            raise InputError(
                f"none of {len(whole)} frames shows the marker board: nothing was drawn"
            )
    return LiveReport(
        frames=len(whole),
        tracked=tracked,
        known=known,
        stage_ms={stage: _median_ms(t.wall for t in spent) for stage, spent in times.items()},
        stage_cpu_ms={stage: _median_ms(t.cpu for t in spent) for stage, spent in times.items()},
        frame_ms=_median_ms(t.wall for t in whole),
        frame_cpu_ms=_median_ms(t.cpu for t in whole),
    )


def _median_ms(seconds: Iterable[float]) -> float:
    return 1000 * float(np.median(list(seconds)))
