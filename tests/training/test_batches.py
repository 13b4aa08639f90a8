from dataclasses import replace

import numpy as np
import pytest
import torch

from skylight.training._config import AutoencoderConfig
from skylight.training._skies import BLOCK, CodedSkies, Corruption, draw_batch, draw_corruption

WHOLE = slice(None)
CONFIG = AutoencoderConfig(batch=4)


def marked(count: int, copies: int = 1) -> list[CodedSkies]:
    """Sky i is i everywhere, its sun 1,000 times the number of the copy."""
    values = np.arange(count, dtype=np.float16)[:, None, None, None]
    coded = np.broadcast_to(values, (count, 3, 32, 128)).copy()
    return [
        CodedSkies(np.full((count, 5), 1000 * copy, np.float32), coded) for copy in range(copies)
    ]


def numbers(batch: torch.Tensor) -> list[int]:
    assert batch.dtype == torch.float32
    return batch[:, 0, 0, 0].int().tolist()


def test_batches_cover_an_epoch_once_and_differ_between_epochs() -> None:
    skies = marked(12)
    seen = [numbers(draw_batch(skies, CONFIG, 0, i, WHOLE)[1]) for i in range(3)]
    assert sorted(number for batch in seen for number in batch) == list(range(12))
    _, again, drawn = draw_batch(skies, CONFIG, 0, 1, WHOLE)
    assert numbers(again) == seen[1]
    for ours, same in zip(drawn, draw_batch(skies, CONFIG, 0, 1, WHOLE)[2], strict=True):
        assert torch.equal(ours, same)
    assert not torch.equal(drawn.noise, draw_batch(skies, CONFIG, 0, 2, WHOLE)[2].noise)
    assert numbers(draw_batch(skies, CONFIG, 1, 1, WHOLE)[1]) != seen[1]


def test_copies_take_turns() -> None:
    skies = marked(8, copies=3)
    suns = [draw_batch(skies, CONFIG, epoch, 1, WHOLE)[0] for epoch in range(5)]
    assert [int(sun[0, 0]) for sun in suns] == [0, 1000, 2000, 0, 1000]


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
    config = replace(CONFIG, latent_noise=0.1, sun_noise=0.1)
    sun, sky, drawn = draw_batch(marked(8), config, 2, 1, WHOLE)
    halves = [draw_batch(marked(8), config, 2, 1, part) for part in (slice(0, 2), slice(2, 4))]
    assert torch.equal(torch.cat([half[0] for half in halves]), sun)
    assert torch.equal(torch.cat([half[1] for half in halves]), sky)
    for ours, wanted in zip(Corruption.stack([half[2] for half in halves]), drawn, strict=True):
        assert torch.equal(ours, wanted)


def test_the_skies_on_disk_stay_as_they_are() -> None:
    skies = marked(4)
    sun, sky, _ = draw_batch(skies, CONFIG, 0, 0, WHOLE)
    sky += 1
    sun += 1
    assert np.array_equal(skies[0].coded, marked(4)[0].coded)
    assert np.array_equal(skies[0].sun, marked(4)[0].sun)
