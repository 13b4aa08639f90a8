import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from skylight.errors import InputError
from skylight.io._tensors import read_tensors, write_tensors
from skylight.models._bundle import load_network, save_network
from skylight.models._convolutional import ConvolutionalAutoencoder
from skylight.models._network import SkyNetwork
from skylight.models._splines import SplineAutoencoder
from skylight.skies._index import read_index
from skylight.training import _autoencoder as training
from skylight.training._autoencoder import schedule, train
from skylight.training._checkpoint import (
    NEWEST,
    PREVIOUS,
    _with_tensors,
    drop_damaged,
    initial_network,
    read_state,
)
from skylight.training._config import AutoencoderConfig, config_yaml, read_config
from skylight.training._processes import Processes
from skylight.training._skies import FOLDER, coded_skies, load_data

ROOT = Path(__file__).parents[2]
ALONE = Processes(rank=0, size=1, device=torch.device("cpu"))


@pytest.fixture(scope="module")
def config(sky_folder: Path) -> AutoencoderConfig:
    """Two epochs of three steps."""
    skies = sum(record.split == "train" for record in read_index(sky_folder))
    return AutoencoderConfig(
        data=sky_folder,
        epochs=2,
        batch=skies // 3,
        warmup_steps=1,
        bfloat16=False,
        checkpoint_steps=2,
    )


@pytest.fixture(scope="module")
def uninterrupted(config: AutoencoderConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole")
    train(replace(config, out=out), report=lambda _: None)
    return out


def state(out: Path) -> dict:
    tensors, metadata = read_tensors(out / NEWEST)
    return _with_tensors(json.loads(metadata["state"]), tensors)


def curves(out: Path) -> list[dict]:
    return json.loads((out / "curves.json").read_text())["curves"]


def same_run(ours: Path, theirs: Path) -> None:
    """Bit by bit the same weights, the same moments, and the same curves but for the speed."""
    name = "model.safetensors"
    assert (ours / name).read_bytes() == (theirs / name).read_bytes()
    a, b = state(ours), state(theirs)
    for name, weight in b["network"].items():
        assert torch.equal(a["network"][name], weight)
    for i, slot in b["optimiser"]["state"].items():
        for name, moment in slot.items():
            assert torch.equal(a["optimiser"]["state"][i][name], moment)
    for row, other in zip(curves(ours), curves(theirs), strict=True):
        assert row.pop("images_per_s") > 0
        assert row == {k: v for k, v in other.items() if k != "images_per_s"}


def test_one_epoch_after_another_learns(uninterrupted: Path, sky_folder: Path) -> None:
    whole = json.loads((uninterrupted / "curves.json").read_text())
    assert whole["data_sha256"] == load_data(sky_folder).hash
    assert [c["step"] for c in whole["curves"]] == [3, 6]
    first, second = (c["train"] for c in whole["curves"])
    assert second < first
    assert isinstance(load_network(uninterrupted / "model.safetensors"), SplineAutoencoder)
    assert not (uninterrupted / FOLDER).exists()
    pictures = sorted(p.name for p in (uninterrupted / "reconstructions").iterdir())
    assert pictures == ["epoch_0001.png", "epoch_0002.png"]


def test_an_interrupted_run_goes_on_bit_by_bit(
    config: AutoencoderConfig,
    uninterrupted: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Stopped in step 6, after the checkpoint of step 4: in the middle of an epoch."""
    config = replace(config, out=tmp_path)
    draw = training.draw_batch

    def interrupted(skies, config, epoch, within, share):
        if (epoch, within) == (1, 2):
            raise KeyboardInterrupt
        return draw(skies, config, epoch, within, share)

    monkeypatch.setattr(training, "draw_batch", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train(config, report=lambda _: None)
    monkeypatch.undo()
    assert state(tmp_path)["progress"]["step"] == 4
    torch.randn(100)  # what else the process draws must not matter
    messages: list[str] = []
    train(config, report=messages.append)
    assert messages[0] == "resuming at step 4 of 6"
    same_run(tmp_path, uninterrupted)


@pytest.mark.slow
def test_a_killed_run_goes_on_bit_by_bit(
    config: AutoencoderConfig, uninterrupted: Path, tmp_path: Path
) -> None:
    """SIGKILL as soon as the first state is there, wherever the run is then."""
    config = replace(config, out=tmp_path, threads=torch.get_num_threads())
    (tmp_path / "run.yaml").write_text(config_yaml(config))
    with (tmp_path / "log").open("w") as log:
        run = subprocess.Popen(
            [sys.executable, str(ROOT / "train.py"), str(tmp_path / "run.yaml")],
            cwd=ROOT,
            stdout=log,
            stderr=log,
        )
        deadline = time.monotonic() + 120
        while not (tmp_path / NEWEST).exists() and run.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.002)
        os.kill(run.pid, signal.SIGKILL)
    assert run.wait() == -signal.SIGKILL, (tmp_path / "log").read_text()
    assert state(tmp_path)["progress"]["step"] < 6
    messages: list[str] = []
    train(config, report=messages.append)
    assert messages[0].startswith("resuming at step")
    same_run(tmp_path, uninterrupted)


def test_a_damaged_state_is_said_and_the_one_before_it_used(
    config: AutoencoderConfig, uninterrupted: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    shutil.copytree(uninterrupted, out)
    newest, identity = out / NEWEST, state(out)["identity"]
    content = bytearray(newest.read_bytes())
    content[len(content) // 2] ^= 1
    # missing: killed between the two renamings
    for damage, left in (("missing", None), ("truncated", content[:-1000]), ("flipped", content)):
        newest.unlink(missing_ok=True)
        if left is not None:
            newest.write_bytes(left)
        said: list[str] = []
        before = read_state(out, identity, said.append)
        assert before is not None
        assert before["progress"]["step"] == 4
        assert [m.split(":")[0] for m in said] == ([] if damage == "missing" else [str(newest)])
    messages: list[str] = []
    train(replace(config, out=out), report=messages.append)
    assert sum("damaged" in m for m in messages) == 1
    assert "resuming at step 4 of 6" in messages
    same_run(out, uninterrupted)
    assert state(out)["progress"]["step"] == 6
    assert (out / PREVIOUS).read_bytes() == (uninterrupted / PREVIOUS).read_bytes()


def test_two_damaged_states_are_refused(
    config: AutoencoderConfig, uninterrupted: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    shutil.copytree(uninterrupted, out)
    for name in (NEWEST, PREVIOUS):
        (out / name).write_bytes(b"")
    with pytest.raises(InputError, match="nothing to go on") as caught:
        train(replace(config, out=out), report=lambda _: None)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("state", ['{"pairs": [["step", 1]]}', '["identity"]', "3"])
def test_a_state_of_nothing_known_is_damaged(tmp_path: Path, state: str) -> None:
    write_tensors(tmp_path / NEWEST, {}, {"state": state})
    with pytest.raises(InputError, match="nothing to go on"):
        read_state(tmp_path, "a run", lambda _: None)


def test_a_state_that_cannot_be_read_is_not_taken_for_damaged(tmp_path: Path) -> None:
    """Damaged ones are removed; this one may be whole behind a disk that fails."""
    (tmp_path / NEWEST).mkdir()
    for ask in (lambda: read_state(tmp_path, "a run"), lambda: drop_damaged(tmp_path)):
        with pytest.raises(InputError, match="cannot be read"):
            ask()
    assert (tmp_path / NEWEST).exists()


def thesis(config: AutoencoderConfig) -> AutoencoderConfig:
    return replace(config, network="convolutions", optimiser="sgd", learning_rate=0.05)


def first_kernel(network: SkyNetwork) -> torch.Tensor:
    assert isinstance(network, ConvolutionalAutoencoder)
    return network.encoder[0][0].conv.weight  # type: ignore[union-attr]


def test_the_encoder_learns_from_corrupted_skies_alone(
    config: AutoencoderConfig, tmp_path: Path
) -> None:
    """Where all of a sky is hidden, the gradient of the first convolution is exactly zero."""

    def changed(masked: float) -> bool:
        hidden = replace(
            thesis(config),
            out=tmp_path / str(masked),
            masked=masked,
            sun=False,
            weight_decay=0.0,
            epochs=1,
            batch=3 * config.batch,
        )
        before, after = (
            first_kernel(network)
            for network in (
                initial_network(hidden),
                load_network(train(hidden, report=lambda _: None)),
            )
        )
        return not torch.equal(before, after)

    assert changed(0.0)
    assert not changed(1.0)


def test_a_finished_run_stays_finished(
    config: AutoencoderConfig, uninterrupted: Path, tmp_path: Path
) -> None:
    """Also after its folder has moved, and with other checkpoints: what changes no step."""
    out = tmp_path / "moved"
    shutil.copytree(uninterrupted, out)
    messages: list[str] = []
    train(replace(config, out=out, checkpoint_steps=7), report=messages.append)
    assert "resuming at step 6 of 6" in messages
    assert not any(message.startswith("epoch") for message in messages)
    name = "model.safetensors"
    assert (out / name).read_bytes() == (uninterrupted / name).read_bytes()


def test_another_configuration_is_refused(config: AutoencoderConfig, uninterrupted: Path) -> None:
    with pytest.raises(InputError, match="another configuration"):
        train(replace(config, out=uninterrupted, seed=1))


def test_the_written_configuration_repeats_the_run(
    uninterrupted: Path, config: AutoencoderConfig
) -> None:
    assert read_config(uninterrupted / "config.yaml") == replace(config, out=uninterrupted)


def test_early_stopping(
    config: AutoencoderConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After ``patience`` epochs without a better score; the best network is kept."""
    scores = iter([3.0, 2.0, 2.5, 2.5, 1.0])

    def validate(*_: object, corrupted: bool = False) -> float:
        return 0.5 if corrupted else next(scores)

    monkeypatch.setattr(training, "validate", validate)
    config = replace(config, out=tmp_path, epochs=5, patience=2, batch=12)
    train(config, report=lambda _: None)
    assert [c["validation"] for c in curves(tmp_path)] == [3.0, 2.0, 2.5, 2.5]
    assert next(scores) == 1.0


def test_divergence_is_said(config: AutoencoderConfig, tmp_path: Path) -> None:
    config = replace(thesis(config), out=tmp_path, batch=12)
    config = replace(config, learning_rate=1e30, gradient_clip=0.0)
    with pytest.raises(InputError, match="diverged"):
        train(config)


def test_too_few_skies(config: AutoencoderConfig, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="batch of 1000"):
        train(replace(config, out=tmp_path, batch=1000))


def test_schedule() -> None:
    """Up over the warm-up, at its height, half way, and down to 1 %, or constant."""
    cosine = AutoencoderConfig(warmup_steps=10)
    rates = [schedule(step, 1010, cosine) for step in range(1010)]
    assert rates[0] == pytest.approx(0.1)
    assert rates[9] == pytest.approx(1)
    assert rates[510] == pytest.approx(0.505)
    assert rates[-1] == pytest.approx(0.01, abs=1e-4)
    assert rates[10:] == sorted(rates[10:], reverse=True)
    constant = replace(cosine, schedule="constant", warmup_steps=2)
    assert [schedule(step, 9, constant) for step in range(9)] == [0.5] + [1.0] * 8


def test_validation_is_the_mean_over_skies_whatever_the_batch(
    config: AutoencoderConfig,
) -> None:
    network = initial_network(config)
    random = torch.rand(5, 32, 128, 3, generator=torch.Generator().manual_seed(0))
    skies = coded_skies(network, random)
    scores = [
        training.validate(network, skies, replace(config, batch=batch), ALONE) for batch in (2, 5)
    ]
    assert scores[0] == pytest.approx(scores[1], rel=1e-5)


def test_weights_to_start_from(
    config: AutoencoderConfig, uninterrupted: Path, tmp_path: Path
) -> None:
    """They are those of the first step; the run is known by their content, not their name."""
    start = uninterrupted / "model.safetensors"
    config = replace(config, out=tmp_path / "out", epochs=1, batch=3 * config.batch)
    warm = replace(config, starts_from=start)
    kept = load_network(start).state_dict()
    for name, weight in initial_network(warm).state_dict().items():
        assert torch.equal(weight, kept[name])
    train(warm, report=lambda _: None)
    moved = shutil.copy(start, tmp_path / "moved.safetensors")
    messages: list[str] = []
    train(replace(warm, starts_from=moved), report=messages.append)
    assert messages[0] == "resuming at step 1 of 1"
    save_network(SplineAutoencoder(config.latents), tmp_path / "other.safetensors")
    for other in (config, replace(warm, starts_from=tmp_path / "other.safetensors")):
        with pytest.raises(InputError, match="another configuration"):
            train(other, report=lambda _: None)


def test_weights_of_another_kind_are_refused(config: AutoencoderConfig, tmp_path: Path) -> None:
    start = tmp_path / "linear.safetensors"
    save_network(ConvolutionalAutoencoder("linear"), start)
    for other in (config, thesis(config), replace(config, latents=32)):
        warm = replace(other, out=tmp_path / "out", starts_from=start)
        with pytest.raises(InputError, match=r"linear\.safetensors: .*linear"):
            train(warm, report=lambda _: None)


def test_the_thesis_network_learns_by_the_same_loop(
    config: AutoencoderConfig, tmp_path: Path
) -> None:
    train(replace(thesis(config), out=tmp_path), report=lambda _: None)
    first, second = (entry["train"] for entry in curves(tmp_path))
    assert second < first
    assert isinstance(load_network(tmp_path / "model.safetensors"), ConvolutionalAutoencoder)
