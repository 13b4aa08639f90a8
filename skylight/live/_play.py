"""Frames as they come: a webcam's newest, or a film's, as fast as they go or as they are shown."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from skylight.errors import InputError
from skylight.imaging._film import FilmFrame, as_rgb, film_frames, opened_film, scaled

MOST_SIDE = 640  # pixels: a face in it is as high as is looked at
_PATIENCE_S = 10.0  # for a webcam's next frame


def source_of(text: str) -> Path | int:
    """A webcam's number or a film's file."""
    return int(text) if text.isdecimal() else Path(text)


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
    """Each at its time; those that are late by more than a tenth of a second are left out."""
    begun: float | None = None
    for frame in frames:
        begun = time.monotonic() - frame.time_s if begun is None else begun
        early = frame.time_s - (time.monotonic() - begun)
        if early > 0:
            time.sleep(early)
        if early > -0.1:
            yield frame


@runtime_checkable
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
        if last < 0:
            raise InputError(
                f"webcam {self._source} gives no picture: see that it is plugged in and free"
            )

    def _after(self, last: int) -> FilmFrame | None:
        """The newest frame once it is another; None where the camera gives no more."""

        def is_new() -> bool:
            return self._frame is not None and self._frame.number != last

        with self._changed:
            self._changed.wait_for(lambda: self._ended or is_new(), timeout=_PATIENCE_S)
            return self._frame if is_new() else None

    def _read(self) -> None:
        begun, number = time.monotonic(), 0
        while not self._ended:
            good, bgr = self._capture.read()
            with self._changed:
                if not good:
                    self._ended = True
                else:
                    self._frame = FilmFrame(
                        number=number,
                        time_s=time.monotonic() - begun,
                        codes=scaled(as_rgb(bgr), MOST_SIDE),
                    )
                self._changed.notify_all()
            number += 1
