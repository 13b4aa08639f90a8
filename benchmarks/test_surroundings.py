"""Seconds of the scenes before a batch of 16 skies."""

import pytest
import torch

from skylight.skies.surroundings._scenes import surroundings


@pytest.mark.parametrize("height", [32, 64])
def test_surroundings(benchmark, height):
    skies = torch.ones(16, height, 4 * height, 3)
    skies[:, height // 2, 2 * height] = 500.0
    generator = torch.Generator().manual_seed(0)
    cover, _ = benchmark(lambda: surroundings(skies, generator))
    assert cover.shape == (16, height, 4 * height, 1)
