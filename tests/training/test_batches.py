from dataclasses import replace

import numpy as np
import pytest
import torch

from skylight.training.batches import draw_batch
from skylight.training.config import AutoencoderConfig

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
    again, noise = draw_batch(skies, CONFIG, 0, 1, WHOLE)
    assert numbers(again) == seen[1]
    assert torch.equal(noise, draw_batch(skies, CONFIG, 0, 1, WHOLE)[1])
    assert not torch.equal(noise, draw_batch(skies, CONFIG, 0, 2, WHOLE)[1])
    assert numbers(draw_batch(skies, CONFIG, 1, 1, WHOLE)[0]) != seen[1]
    assert float(noise.std()) == pytest.approx(CONFIG.noise_sigma, rel=0.02)
    assert float(noise.mean()) == pytest.approx(0, abs=2e-4)


def test_shares_together_are_the_batch() -> None:
    """With augmentation: every sky is varied as it would be in one process."""
    skies = np.random.default_rng(0).random((8, 32, 128, 3), dtype=np.float32)
    config = replace(CONFIG, mirror=True, tint=0.1)
    whole = draw_batch(skies, config, 2, 1, WHOLE)
    halves = [draw_batch(skies, config, 2, 1, part) for part in (slice(0, 2), slice(2, 4))]
    for together, parts in zip(whole, zip(*halves, strict=True), strict=True):
        assert torch.equal(torch.cat(parts), together)


def test_the_skies_on_disk_stay_as_they_are() -> None:
    skies = marked(4)
    batch, _ = draw_batch(skies, CONFIG, 0, 0, WHOLE)
    batch += 1
    assert np.array_equal(skies, marked(4))
