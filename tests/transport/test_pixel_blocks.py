"""Means over blocks of pixels against loops."""

import torch

from skylight.transport._visibility import PixelBlocks


def test_means_are_those_of_a_loop():
    generator = torch.Generator().manual_seed(0)
    places = torch.stack(torch.meshgrid(torch.arange(7), torch.arange(9), indexing="ij"), -1)
    places = places.flatten(0, 1)
    weights = torch.rand(len(places), generator=generator, dtype=torch.float64)
    weights[::5] = 0
    clipped = torch.rand(len(places), generator=generator) < 0.3
    values = torch.rand(len(places), 2, generator=generator, dtype=torch.float64)
    blocks = PixelBlocks.of(places, weights, clipped, 2)
    means, heaviest, count = blocks.means(values), blocks.heaviest(), 0
    assert blocks.clipped is not None
    for b, (place, over) in enumerate(zip(blocks.places, blocks.clipped, strict=True)):
        inside = (places // 2 == place).all(1) & (clipped == over) & (weights > 0)
        count += int(inside.sum())
        total = weights[inside].sum()
        torch.testing.assert_close(blocks.weights[b], total)
        torch.testing.assert_close(means[b], (weights[inside] @ values[inside]) / total)
        assert weights[heaviest[b]] == weights[inside].max()
    assert count == len(blocks.members) == int((weights > 0).sum())
