"""Augmented video: frames read from a video or a webcam, composited and written."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from jaxtyping import UInt8

from skylight.cameras.frames import film
from skylight.cameras.live import Clock, LiveFrame, Times
from skylight.errors import InputError, OutputError
from skylight.imaging.film import film_rate, require_film
from skylight.io.atomic import atomic_path, require_place

_FRAME = "frame"
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
    if out.suffix.lower() != ".mp4":
        raise InputError(f"{out}: films are written as .mp4; choose another name")
    if most is not None and most < 1:
        raise InputError(f"at least 1 frame is needed, got {most}")
    require_film(source)
    require_place(out)


def write_film(
    source: Path | int, out: Path, show: Show, *, size: tuple[int, int], most: int | None = None
) -> LiveReport:
    """Write ``out`` (.mp4, ``size`` is width and height) with what each frame becomes.

    Ctrl-C ends a webcam's film, which is kept.

    Raises
    ------
    InputError
        The source or another file cannot be used, or no frame shows the board.
    """
    check_film(source, out, most)
    rate = film_rate(source)
    times: dict[str, list[Times]] = {}
    whole: list[Times] = []
    tracked = known = 0
    with atomic_path(out) as temporary:
        made = _writer(temporary, rate, *size)
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
                    made.write(cv2.cvtColor(frame.picture, cv2.COLOR_RGB2BGR))
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
        finally:
            made.release()
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


def _writer(path: Path, rate: float, width: int, height: int) -> cv2.VideoWriter:
    code = cv2.VideoWriter.fourcc(*"mp4v")
    made = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, rate, (width, height))
    if not made.isOpened():
        raise OutputError(f"cannot write a film to {path.parent}: choose another folder")
    return made
