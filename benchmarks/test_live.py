"""Live relighting of 640 x 480 pixels: boards followed through a film, and searched in each frame.

Both probes, on one thread. A run of rounds is a film there and back, 3 degrees a frame. Seconds
are the processor's, of which the clock shows more where other work goes on.
"""

from collections.abc import Iterator
from itertools import chain, cycle
from pathlib import Path
from statistics import median
from time import process_time

import cv2
import numpy as np
import pytest
import torch

from skylight.probes._capture import LiveView
from skylight.probes.cameras._live import LiveFrame
from skylight.probes.cameras._tracking import BoardTracker
from tests.probes.partitions.boards import box
from tests.probes.test_live_light import (
    ORBIT,
    partition_film,
    partition_view,
    searched,
    voxel_film,
    voxel_view,
)

WAY = [(40.0 + 3 * i, 35.0) for i in range(12)]
ROUNDS = 66
Film = list[np.ndarray]


@pytest.fixture(params=["voxel", "partitions"])
def live(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[list[LiveView], Film]]:
    """Two views that have seen all sides of a probe, and a film."""
    threads = torch.get_num_threads(), cv2.getNumThreads()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    if request.param == "voxel":
        views, make = [voxel_view() for _ in range(2)], voxel_film
    else:
        views, make = [partition_view(tmp_path, box(), 1.0) for _ in range(2)], partition_film
    for image in make(ORBIT):
        for view in views:
            view.show(image)
    yield views, make(WAY)
    torch.set_num_threads(threads[0])
    cv2.setNumThreads(threads[1])


def test_live_film(
    benchmark, monkeypatch: pytest.MonkeyPatch, live: tuple[list[LiveView], Film]
) -> None:
    """Frames a second; each frame is searched before it is followed, for the ratio."""
    (following, searching), film = live
    there_and_back = cycle(chain(film, film[-2:0:-1]))
    times: dict[str, list[float]] = {"followed": [], "searched": []}
    shown = []

    def timed(name: str, view: LiveView, image: np.ndarray) -> LiveFrame:
        begun = process_time()
        frame = view.show(image)
        times[name].append(process_time() - begun)
        return frame

    def search() -> tuple[tuple[np.ndarray], dict[str, object]]:
        image = next(there_and_back)
        with monkeypatch.context() as patch:
            patch.setattr(BoardTracker, "pose", searched)
            timed("searched", searching, image)
        return (image,), {}

    def follow(image: np.ndarray) -> None:
        shown.append(timed("followed", following, image))

    benchmark.pedantic(follow, setup=search, rounds=ROUNDS, warmup_rounds=2)
    assert all(frame.tracked for frame in shown)
    followed, whole = median(times["followed"]), median(times["searched"])
    benchmark.extra_info |= {
        "frames_per_s": 1 / benchmark.stats["median"],
        "frames_per_cpu_s": 1 / followed,
        "ratio": whole / followed,
        **{
            f"{stage}_cpu_ms": 1000 * median(frame.times[stage].cpu for frame in shown)
            for stage in shown[-1].times
        },
    }
    print(benchmark.extra_info)
