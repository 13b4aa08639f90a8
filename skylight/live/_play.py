"""Frames as they come: a webcam's newest, or a film's, as fast as they go or as they are shown."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import cv2

from skylight.errors import InputError
from skylight.imaging._film import FilmFrame, as_rgb, film_frames, opened_film, scaled

MOST_SIDE = 640  # pixels: a face in it is as high as is looked at
_PATIENCE_S = 10.0  # for a webcam's next frame
_LATE_S, _NOTHING_S = 0.1, 0.5  # of a film that is shown in time
_MOST_WEBCAM = 99  # OpenCV reads more as 100 times the number of a driver, plus the webcam's


def source_of(text: str) -> Path | int:
    """A webcam's number or a film's file."""
    if not text.isdecimal():
        return Path(text)
    if len(text.lstrip("0")) > len(str(_MOST_WEBCAM)):
        raise InputError(
            f"webcams are numbered from 0 to {_MOST_WEBCAM}, got {text}; write ./{text} for a film"
        )
    return int(text)


@contextmanager
def played(
    source: Path | int, *, every: int = 1, in_time: bool = False
) -> Iterator[Iterator[FilmFrame]]:
    """One of ``every`` so many frames, scaled to :data:`MOST_SIDE`.

    A webcam's are those that come last, until it is unplugged: what is late is left out. So it is
    with a film ``in_time``, which is shown as fast as it was taken; else it goes as fast as its
    frames are asked for.
    """
    if every < 1:
        raise InputError(f"--every must be 1 or more, got {every}")
    if isinstance(source, int):
        with opened_film(source) as capture, _Newest(capture, source) as newest:
            yield (frame for frame in newest.frames() if frame.number % every == 0)
        return
    frames = film_frames(source, most_side=MOST_SIDE)
    chosen = (frame for frame in frames if frame.number % every == 0)
    yield _shown(chosen) if in_time else chosen


def _shown(frames: Iterator[FilmFrame]) -> Iterator[FilmFrame]:
    """Each at its time; those that are late by more than a tenth of a second are left out.

    Where half a second passes with nothing shown, as what decodes is slower than the film, the next
    frame is, and the film goes on from there.
    """
    shown = time.monotonic()
    begun: float | None = None
    for frame in frames:
        begun = time.monotonic() - frame.time_s if begun is None else begun
        early = frame.time_s - (time.monotonic() - begun)
        if early > 0:
            time.sleep(early)
        elif early <= -_LATE_S:
            if time.monotonic() - shown < _NOTHING_S:
                continue
            begun -= early
        yield frame
        shown = time.monotonic()


@runtime_checkable  # for the checks of types in tests
class _Camera(Protocol):
    """What OpenCV's capture does."""

    def read(self) -> tuple[bool, Any]: ...


class _Newest:
    """Reads a camera on a thread of its own, so that what waits is never an old frame."""

    def __init__(self, capture: _Camera, source: int) -> None:
        self._capture, self._source = capture, source
        self._changed = threading.Condition()
        self._frame: FilmFrame | None = None
        self._ended = False
        self._why = f"no picture came for {_PATIENCE_S:g} s"
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._read, daemon=True)

    def __enter__(self) -> "_Newest":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._ended = True
        self._thread.join(_PATIENCE_S)  # a camera is not to be closed while it is read

    def frames(self) -> Iterator[FilmFrame]:
        last = -1
        while (frame := self._after(last)) is not None:
            last = frame.number
            yield frame
        if self._failure is not None and not isinstance(self._failure, cv2.error):
            raise self._failure
        if last < 0:
            raise InputError(
                f"webcam {self._source} gives no picture: see that it is plugged in and free"
            ) from self._failure
        print(f"webcam {self._source} ended: {self._why}", flush=True)

    def _after(self, last: int) -> FilmFrame | None:
        """The newest frame once it is another; None where the camera gives no more."""

        def is_new() -> bool:
            return self._frame is not None and self._frame.number != last

        with self._changed:
            self._changed.wait_for(lambda: self._ended or is_new(), timeout=_PATIENCE_S)
            return self._frame if is_new() else None

    def _read(self) -> None:
        begun, number = time.monotonic(), 0
        try:
            while not self._ended:
                good, bgr = self._capture.read()
                if not good:
                    self._why = "it gives no more pictures"
                    break
                codes = scaled(as_rgb(bgr), MOST_SIDE)
                with self._changed:
                    self._frame = FilmFrame(
                        number=number, time_s=time.monotonic() - begun, codes=codes
                    )
                    self._changed.notify_all()
                number += 1
        except Exception as error:  # raised or told where the frames are asked for
            self._failure, self._why = error, " ".join(str(error).split())
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()
