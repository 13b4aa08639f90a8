"""Shading that follows what is seen."""

import numpy as np
import pytest
import torch

from skylight.probes.partitions._captured import FaceSample
from skylight.probes.partitions.relight._live import RunningShading


def sample(cell: int, value: float, *, area: float = 50.0, clipped: float = 0.0) -> FaceSample:
    return FaceSample(
        cell=cell,
        radiance=torch.full((3,), value, dtype=torch.float64),
        area_px=area,
        clipped=clipped,
    )


def test_first_sight_counts_whole_and_later_ones_blend() -> None:
    running = RunningShading(torch.zeros(2, 3).double(), torch.zeros(2, dtype=torch.bool))
    assert running.add([sample(1, 0.5)]) == 1
    assert running.known.tolist() == [False, True]
    assert running.shading[1].tolist() == [0.5] * 3
    for _ in range(5):
        running.add([sample(1, 1.0)])
    # 1 - 0.5 x 0.8^5
    assert float(running.shading[1, 0]) == pytest.approx(0.83616)


def test_noise_is_averaged() -> None:
    running = RunningShading(torch.zeros(1, 3).double(), torch.zeros(1, dtype=torch.bool))
    noise = np.random.default_rng(0).normal(0.5, 0.1, 2000)
    kept = []
    for value in noise:
        running.add([sample(0, value)])
        kept.append(float(running.shading[0, 0]))
    # of an exponential mean with weight a, variance falls by a / (2 - a)
    assert np.std(kept[50:]) == pytest.approx(0.1 * np.sqrt(0.2 / 1.8), rel=0.15)


def test_what_cannot_be_read_is_left_alone() -> None:
    running = RunningShading(torch.full((2, 3), 0.3), torch.ones(2, dtype=torch.bool))
    assert running.add([sample(0, 0.9, clipped=0.5), sample(1, 0.9, area=2.0)]) == 0
    assert (running.shading == 0.3).all()
