import json
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from skylight.imaging._colour import tone_map
from skylight.models._convolutional import ConvolutionalAutoencoder
from skylight.training._checkpoint import WHITE, reconstructions, spread, write_epoch

SKIES = np.random.default_rng(0).random((20, 32, 128, 3), dtype=np.float32)


def test_truth_stands_over_reconstruction() -> None:
    network = ConvolutionalAutoencoder()
    picture = reconstructions(network, torch.from_numpy(SKIES[:8]))
    assert picture.shape == (64, 8 * 128, 3)
    for i in (0, 7):
        column = picture[:, 128 * i : 128 * (i + 1)]
        truth = torch.from_numpy(SKIES[i])
        assert np.array_equal(column[:32], tone_map(truth, white=WHITE))
        with torch.no_grad():
            again = network.eval().decode(network.encode(truth[None]))[0]
        shown = tone_map(again, white=WHITE)
        assert np.abs(column[32:].astype(int) - shown.astype(int)).max() <= 1


def test_every_epoch_leaves_its_curve_and_picture(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 255, (64, 128, 3), dtype=np.uint8)
    curves: list[dict[str, int | float]] = []
    for epoch in (1, 2):
        curves.append({"step": 4 * epoch, "train": 1 / epoch})
        write_epoch(tmp_path, {"skies": 3}, curves, picture // epoch)
        shown = Image.open(tmp_path / "reconstructions" / f"epoch_{epoch:04d}.png")
        assert np.array_equal(shown, picture // epoch)
        assert json.loads((tmp_path / "curves.json").read_text()) == {"skies": 3, "curves": curves}


def test_the_same_skies_are_shown_every_time() -> None:
    """Eight, from the first to the last."""
    assert spread(SKIES).shape == (8, 32, 128, 3)
    assert np.array_equal(spread(SKIES)[[0, -1]], SKIES[[0, -1]])
    assert np.array_equal(spread(SKIES[:3]), SKIES[:3])
