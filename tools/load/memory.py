"""The resident memory of the studio's processes over time, and its trend (Linux)."""

import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

EVERY_S = 5.0
LOADING_MIN = 1.0  # of a process that has just started, whose growth is no trend
# a module that each worker process is told to import, which its command line names
_WORKERS = {"jobs": "skylight.studio.tasks._light", "reader": "skylight.studio.tasks._uploads"}


@dataclass(frozen=True, kw_only=True)
class Sample:
    """``megabytes`` (10^6 bytes) of a process at ``minute`` after the first sample."""

    minute: float
    process: int
    megabytes: float


@dataclass
class Sampler:
    """Samples a server and its two workers from a thread, until ``end``."""

    server: int
    samples: dict[str, list[Sample]] = field(
        default_factory=lambda: {"server": [], **{name: [] for name in _WORKERS}}
    )

    def __post_init__(self) -> None:
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def end(self) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        begun = time.monotonic()
        while not self._over.wait(EVERY_S):
            minute = (time.monotonic() - begun) / 60
            for name, process in {"server": self.server, **self._workers()}.items():
                with suppress(OSError):  # it has just ended
                    megabytes = resident_mb(process)
                    sample = Sample(minute=minute, process=process, megabytes=megabytes)
                    self.samples[name].append(sample)

    def _workers(self) -> dict[str, int]:
        found = {}
        children = Path(f"/proc/{self.server}/task/{self.server}/children")
        with suppress(OSError):
            for process in map(int, children.read_text().split()):
                with suppress(OSError):
                    words = Path(f"/proc/{process}/cmdline").read_text().split("\0")
                    found |= {name: process for name, one in _WORKERS.items() if one in words}
        return found


def resident_mb(process: int) -> float:
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) * 1024 / 1e6
    raise ProcessLookupError(f"process {process} has no memory any more")


def trend(samples: Sequence[Sample]) -> dict[str, float]:
    """The least squares slope of the second half (by time), with a level for each process.

    Of every process the first ``LOADING_MIN`` are left out. ``noise_mb`` is the standard deviation
    about the lines; ``slope_error_mb_per_min`` the slope's standard error were samples independent
    (they are not quite: it is too small rather than too large). Where there are too few samples for
    a slope it is left out.
    """
    told: dict[str, float] = {"samples": len(samples)}
    if not samples:
        return told
    told |= {
        "processes": len({one.process for one in samples}),
        "peak_mb": max(one.megabytes for one in samples),
        "last_mb": samples[-1].megabytes,
    }
    first = {one.process: one.minute for one in reversed(samples)}
    half = (samples[0].minute + samples[-1].minute) / 2
    of: dict[int, list[tuple[float, float]]] = {}
    for one in samples:
        if one.minute >= half and one.minute - first[one.process] >= LOADING_MIN:
            of.setdefault(one.process, []).append((one.minute, one.megabytes))
    lines = [np.array(each) - np.mean(each, axis=0) for each in of.values()]
    count = sum(map(len, lines))
    if count < len(lines) + 2:
        return told
    minutes, megabytes = np.concatenate(lines).T
    slope = float(minutes @ megabytes / (minutes @ minutes))
    noise = float(np.sqrt(np.sum((megabytes - slope * minutes) ** 2) / (count - len(lines) - 1)))
    return told | {
        "slope_samples": count,
        "slope_mb_per_min": slope,
        "slope_error_mb_per_min": noise / float(np.sqrt(minutes @ minutes)),
        "noise_mb": noise,
    }
