"""Frames and timings of live views."""

import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8


@dataclass(frozen=True, kw_only=True)
class LiveFrame:
    """A frame with the model in it, or as it came where that is not known yet.

    ``known`` counts what of the probe was captured so far; ``seconds`` are those of each stage that
    was reached.
    """

    picture: UInt8[np.ndarray, "h w 3"]
    tracked: bool
    known: int
    seconds: dict[str, float]


class Clock:
    """Seconds of each stage, from mark to mark."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def mark(self, stage: str) -> None:
        """The stage that began at the last mark ends here."""
        now = time.perf_counter()
        self.seconds[stage] = now - self._last
        self._last = now
