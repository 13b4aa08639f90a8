from dataclasses import replace

import numpy as np
import pytest
import torch

from skylight.training.batches import draw_batch
from skylight.training.config import AutoencoderConfig
from skylight.training.corruption import BLOCK, Corruption, draw_corruption

WHOLE = slice(None)
CONFIG = AutoencoderConfig(batch=4, mirror=False)


def marked(count: int) -> np.ndarray:
    """Sky i is bright in column i."""
    skies = np.ones((count, 32, 128, 3), dtype=np.float32)
    skies[range(count), :, range(count)] = 2
    return skies


def numbers(batch: torch.Tensor) -> list[int]:
    return batch[:, 0, :, 0].argmax(1).tolist()


def test_batches_cover_an_epoch_once_and_differ_between_epochs() -> None:
    skies = marked(12)
    seen = [numbers(draw_batch(skies, CONFIG, 0, i, WHOLE)[0]) for i in range(3)]
    assert sorted(number for batch in seen for number in batch) == list(range(12))
    again, drawn = draw_batch(skies, CONFIG, 0, 1, WHOLE)
    assert numbers(again) == seen[1]
    for ours, same in zip(drawn, draw_batch(skies, CONFIG, 0, 1, WHOLE)[1], strict=True):
        assert torch.equal(ours, same)
    assert not torch.equal(drawn.noise, draw_batch(skies, CONFIG, 0, 2, WHOLE)[1].noise)
    assert numbers(draw_batch(skies, CONFIG, 1, 1, WHOLE)[0]) != seen[1]


def test_corruption_is_as_strong_as_the_configuration_says() -> None:
    config = replace(CONFIG, noise_sigma=0.2, masked=0.25, sun_noise=0.1)
    drawn = draw_corruption(200, (32, 128), torch.Generator().manual_seed(0), config)
    assert float(drawn.noise.std()) == pytest.approx(0.2, rel=0.01)
    assert float(drawn.noise.mean()) == pytest.approx(0, abs=1e-3)
    assert float(drawn.sun.std()) == pytest.approx(0.1, rel=0.1)
    assert float(1 - drawn.kept.mean()) == pytest.approx(0.25, abs=0.02)
    blocks = drawn.kept.reshape(200, 4, BLOCK, 16, BLOCK)
    assert torch.equal(blocks.amin((2, 4)), blocks.amax((2, 4)))  # whole blocks


def test_shares_together_are_the_batch() -> None:
    """With augmentation: every sky is varied as it would be in one process."""
    skies = np.random.default_rng(0).random((8, 32, 128, 3), dtype=np.float32)
    config = replace(CONFIG, mirror=True, tint=0.1)
    whole = draw_batch(skies, config, 2, 1, WHOLE)
    halves = [draw_batch(skies, config, 2, 1, part) for part in (slice(0, 2), slice(2, 4))]
    assert torch.equal(torch.cat([sky for sky, _ in halves]), whole[0])
    for ours, wanted in zip(
        Corruption.stack([drawn for _, drawn in halves]), whole[1], strict=True
    ):
        assert torch.equal(ours, wanted)


def test_the_skies_on_disk_stay_as_they_are() -> None:
    skies = marked(4)
    batch, _ = draw_batch(skies, CONFIG, 0, 0, WHOLE)
    batch += 1
    assert np.array_equal(skies, marked(4))
