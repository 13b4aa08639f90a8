import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from skylight.imaging._colour import tone_map
from skylight.models._convolutional import ConvolutionalAutoencoder
from skylight.training._checkpoint import WHITE, Logs, reconstructions

SKIES = np.random.default_rng(0).random((20, 32, 128, 3), dtype=np.float32)


def entry(step: int) -> dict[str, int | float]:
    names = ("train", "validation", "learning_rate", "images_per_s", "denoising")
    return {"step": step, **{name: step + i / 8 for i, name in enumerate(names)}}


def written(out: Path, messages: list[str]) -> None:
    out.mkdir()
    logs = Logs(out, SKIES, facts={"skies": 3}, step=0, report=messages.append)
    curves = []
    for step in (4, 8):
        curves.append(entry(step))
        logs.epoch(ConvolutionalAutoencoder(), curves, best=4.5)
    logs.close()


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


def test_pictures_and_scalars_of_every_epoch(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    messages: list[str] = []
    written(tmp_path / "run", messages)
    for epoch in (1, 2):
        path = tmp_path / "run" / "reconstructions" / f"epoch_{epoch:04d}.png"
        assert Image.open(path).size == (8 * 128, 64)
    events = EventAccumulator(str(tmp_path / "run" / "tensorboard")).Reload()
    for tag, name in (
        ("loss/train", "train"),
        ("loss/validation", "validation"),
        ("learning_rate", "learning_rate"),
        ("images_per_s", "images_per_s"),
    ):
        values = [(e.step, e.value) for e in events.Scalars(tag)]
        assert values == [(step, entry(step)[name]) for step in (4, 8)]
    assert [i.step for i in events.Images("reconstructions")] == [4, 8]
    assert [m.split("  ")[0] for m in messages] == ["epoch 1", "epoch 2"]


def test_without_tensorboard_one_line_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    messages: list[str] = []
    written(tmp_path / "run", messages)
    assert sum("no TensorBoard logs" in m for m in messages) == 1
    assert not (tmp_path / "run" / "tensorboard").exists()
    assert (tmp_path / "run" / "reconstructions" / "epoch_0002.png").exists()


def test_the_same_skies_are_shown_every_time(tmp_path: Path) -> None:
    """Eight, from the first to the last."""
    logs = Logs(tmp_path, SKIES, facts={}, step=0, report=lambda _: None)
    assert len(logs.truth) == 8
    assert np.array_equal(logs.truth[0], SKIES[0])
    assert np.array_equal(logs.truth[-1], SKIES[-1])
    few = Logs(tmp_path, SKIES[:3], facts={}, step=0, report=lambda _: None)
    assert np.array_equal(few.truth, SKIES[:3])
