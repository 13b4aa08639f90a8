"""Frames and timings of live views."""

import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8


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
