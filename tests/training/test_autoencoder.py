"""Runs of the autoencoder, interrupted ones too, and its loss."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
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
from skylight.training._autoencoder import RunState, reconstruction_loss, schedule, train
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
from skylight.training._skies import (
    FOLDER,
    Corruption,
    coded_skies,
    draw_batch,
    draw_corruption,
    load_data,
)

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
    data = load_data(sky_folder)
    facts = {name: whole[name] for name in ("data_sha256", "skies", "processes")}
    assert facts == {"data_sha256": data.hash, "skies": len(data.train), "processes": 1}
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
        read_state(tmp_path, {}, lambda _: None)


def test_a_state_that_cannot_be_read_is_not_taken_for_damaged(tmp_path: Path) -> None:
    """Damaged ones are removed; this one may be whole behind a disk that fails."""
    (tmp_path / NEWEST).mkdir()
    for ask in (lambda: read_state(tmp_path, {}), lambda: drop_damaged(tmp_path)):
        with pytest.raises(InputError, match="cannot be read"):
            ask()
    assert (tmp_path / NEWEST).exists()


def thesis(config: AutoencoderConfig) -> AutoencoderConfig:
    return replace(config, network="convolutions", optimiser="sgd", learning_rate=0.05)


@pytest.mark.parametrize("masked", [0.0, 1.0])
def test_the_encoder_learns_from_corrupted_skies_alone(masked: float) -> None:
    """Where all of a sky is hidden, the gradient of the first convolution is exactly zero."""
    config = AutoencoderConfig(network="convolutions", sun=False, batch=2, masked=masked)
    network = initial_network(config)
    sky = torch.rand(2, 32, 128, 3, generator=torch.Generator().manual_seed(0))
    batch = draw_batch([coded_skies(network, sky)], config, 0, 0, slice(None))
    training.Objective(network, config)(*batch).backward()
    gradient = network.get_parameter("encoder.0.0.conv.weight").grad
    assert gradient is not None
    assert bool(gradient.any()) == (masked == 0)


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


def test_more_epochs_are_those_of_a_longer_run(
    config: AutoencoderConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a constant rate bit by bit, whether the shorter run had ended or not."""
    config = replace(config, schedule="constant", epochs=3, batch=3 * config.batch, latents=8)
    train(replace(config, out=tmp_path / "whole"), report=lambda _: None, callbacks=[])
    short = replace(config, out=tmp_path / "short", epochs=1)
    train(short, report=lambda _: None, callbacks=[])
    said: list[str] = []
    with monkeypatch.context() as patched:
        patched.setattr(training, "validate", lambda *_, **__: 1 / 0)
        with pytest.raises(ZeroDivisionError):  # within the second epoch
            train(replace(short, epochs=2), report=said.append, callbacks=[])
    assert said[:2] == [
        "resuming at step 1 of 2",
        "`epochs` was 1 and is 2: the learning rate is 0.001 here, 0.001 before",
    ]
    train(replace(short, epochs=3), report=said.append, callbacks=[])
    assert "`epochs` was 1 and is 3: the learning rate is 0.001 here, 0.001 before" in said
    same_run(tmp_path / "short", tmp_path / "whole")
    again: list[str] = []
    train(replace(short, epochs=2), report=again.append, callbacks=[])
    assert again[0] == "`epochs` was 3 and is 2: 3 are done already, and none is taken back"
    assert not any(line.startswith("epoch ") for line in again)


def test_a_cosine_rises_again_with_more_epochs(
    config: AutoencoderConfig, uninterrupted: Path, tmp_path: Path
) -> None:
    """Down at its end, and half way down where twice as many are to come."""
    out = tmp_path / "run"
    shutil.copytree(uninterrupted, out)
    said: list[str] = []
    train(replace(config, out=out, epochs=4), report=said.append, callbacks=[])
    here = 0.001 * (0.01 + 0.99 * (1 + np.cos(np.pi * 5 / 11)) / 2)  # the first of 12 warms up
    assert said[1].endswith(f": the learning rate is {here:.3g} here, 1e-05 before")
    rates = [entry["learning_rate"] for entry in curves(out)]
    assert rates[2] == pytest.approx(0.001 * schedule(8, 12, config))
    assert rates[2] > rates[1] > rates[3]


def test_another_configuration_is_refused(config: AutoencoderConfig, uninterrupted: Path) -> None:
    other = replace(config, out=uninterrupted, seed=1, coding="log", tint=0.5, threads=1)
    with pytest.raises(InputError, match=r"`tint` was 0\.0 and is 0\.5, `seed` was 0 and is 1; go"):
        train(other, report=lambda _: None)


def test_the_written_configuration_repeats_the_run(
    uninterrupted: Path, config: AutoencoderConfig
) -> None:
    assert read_config(uninterrupted / "config.yaml") == replace(config, out=uninterrupted)


def test_an_epoch_that_is_no_better_is_counted() -> None:
    now = RunState(step=3, losses=[1.0, 3.0])
    assert (now.since_best, now.curves) == (0, [])
    assert now.end_epoch(validation=2.0)
    assert (now.best, now.since_best, now.losses) == (2, 0, [])
    assert now.curves == [{"step": 3, "train": 2, "validation": 2}]
    for count in (1, 2):
        now.losses = [1.0]
        assert not now.end_epoch(validation=2.0)
        assert (now.best, now.since_best) == (2, count)
    now.losses = [1.0]
    assert now.end_epoch(validation=1.5)
    assert (now.best, now.since_best, len(now.curves)) == (1.5, 0, 4)


def test_early_stopping(
    config: AutoencoderConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After ``patience`` epochs without a better score; the best network is kept."""
    scores, judged = iter([3.0, 2.0, 2.5, 2.5, 1.0]), []

    def validate(network: SkyNetwork, *_: object, corrupted: bool = False) -> float:
        if corrupted:
            return 0.5
        save_network(network, tmp_path / "judged.safetensors")
        judged.append((tmp_path / "judged.safetensors").read_bytes())
        return next(scores)

    monkeypatch.setattr(training, "validate", validate)
    config = replace(config, out=tmp_path, epochs=5, patience=2, batch=12)
    said: list[str] = []
    train(config, report=said.append)
    assert [c["validation"] for c in curves(tmp_path)] == [3.0, 2.0, 2.5, 2.5]
    kept = (tmp_path / "model.safetensors").read_bytes()
    assert [kept == one for one in judged] == [False, True, False, False]
    train(config, report=said.append)
    assert sum("no better validation loss for 2 epochs" in line for line in said) == 2
    train(replace(config, patience=3), report=said.append)
    assert [c["validation"] for c in curves(tmp_path)][4:] == [1.0]


def test_divergence_is_said(config: AutoencoderConfig, tmp_path: Path) -> None:
    config = replace(thesis(config), out=tmp_path, batch=12)
    config = replace(config, learning_rate=1e30, gradient_clip=0.0)
    with pytest.raises(InputError, match="diverged"):
        train(config)


def test_too_few_skies(config: AutoencoderConfig, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="batch of 1000"):
        train(replace(config, out=tmp_path, batch=1000))


@pytest.mark.parametrize(("name", "kind"), [("adamw", torch.optim.AdamW), ("sgd", torch.optim.SGD)])
def test_the_optimiser_is_the_configuration_s(
    config: AutoencoderConfig, name: Literal["adamw", "sgd"], kind: type
) -> None:
    chosen = replace(config, optimiser=name, learning_rate=0.25, weight_decay=0.5)
    found = training._optimiser(SplineAutoencoder(8), chosen)
    assert isinstance(found, kind)
    assert (found.defaults["lr"], found.defaults["weight_decay"]) == (0.25, 0.5)


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
    assert [schedule(step, 29, constant) for step in range(9)] == [0.5] + [1.0] * 8
    assert [schedule(step, 9, constant) for step in range(9)] == [1.0] * 9  # no tenth of nine


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
        with pytest.raises(
            InputError, match=r"configuration: `starts_from` was SHA-256 \w+ and is"
        ):
            train(other, report=lambda _: None)


def test_weights_of_another_kind_are_refused(config: AutoencoderConfig, tmp_path: Path) -> None:
    start = tmp_path / "linear.safetensors"
    save_network(ConvolutionalAutoencoder(coding="linear"), start)
    for other in (config, thesis(config), replace(config, latents=32)):
        warm = replace(other, out=tmp_path / "out", starts_from=start)
        with pytest.raises(InputError, match=r"linear\.safetensors: .*linear"):
            train(warm, report=lambda _: None)


@pytest.mark.slow
def test_the_thesis_network_learns_by_the_same_loop(
    config: AutoencoderConfig, tmp_path: Path
) -> None:
    train(replace(thesis(config), out=tmp_path), report=lambda _: None)
    first, second = (entry["train"] for entry in curves(tmp_path))
    assert second < first
    assert isinstance(load_network(tmp_path / "model.safetensors"), ConvolutionalAutoencoder)


def skies() -> tuple[np.ndarray, np.ndarray]:
    true, predicted = np.random.default_rng(0).exponential(2.0, (2, 3, 32, 128, 3))
    return true, predicted


def loss_of(predicted: np.ndarray, true: np.ndarray, config: AutoencoderConfig) -> np.ndarray:
    """The loss of a network that decodes ``predicted``, whatever it is given."""
    network = ConvolutionalAutoencoder(sun=False)
    coded = torch.tensor(np.log1p(predicted)).permute(0, 3, 1, 2).float()
    network.decode_coded = lambda z: coded  # type: ignore[method-assign]
    with torch.no_grad():
        return loss_of_sky(network, torch.tensor(true).float(), config).numpy()


def loss_of_sky(
    network: ConvolutionalAutoencoder,
    sky: torch.Tensor,
    config: AutoencoderConfig,
    corruption: Corruption | None = None,
) -> torch.Tensor:
    sun, rest = network.split(sky)
    return reconstruction_loss(network, sun, network.code(rest), config, corruption)


@pytest.mark.parametrize("energy_weight", [0.0, 0.3])
@pytest.mark.parametrize("scale_invariant", [0.0, 2.0])
@pytest.mark.parametrize("squared_weight", [0.0, 0.7])
def test_loss_is_its_formula(
    energy_weight: float, scale_invariant: float, squared_weight: float
) -> None:
    true, predicted = skies()
    config = AutoencoderConfig(
        energy_weight=energy_weight, scale_invariant=scale_invariant, squared_weight=squared_weight
    )
    edges = np.cos(np.linspace(0, np.pi / 2, 33))
    row = (edges[:-1] - edges[1:]) * 2 * np.pi / 128
    share = np.broadcast_to(row[None, :, None, None] / (2 * np.pi) / 3, true.shape)
    d = np.log1p(predicted) - np.log1p(true)
    each = (1 + energy_weight * np.maximum(true, predicted)) * np.abs(d) + squared_weight * d**2
    axes = (1, 2, 3)
    spread = (share * d**2).sum(axes) - (share * d).sum(axes) ** 2
    expected = (share * each).sum(axes) + scale_invariant * spread
    np.testing.assert_allclose(loss_of(predicted, true, config), expected, rtol=1e-5)


def test_a_sun_with_its_own_head_is_not_the_networks_concern() -> None:
    """The same loss whatever the sun's strength, but for its coordinates in the decoder."""
    network = ConvolutionalAutoencoder(sun=True)
    seen = []
    coded = torch.zeros(1, 3, 32, 128)
    network.decode_coded = lambda z: seen.append(z) or coded  # type: ignore[method-assign]
    losses = []
    for strength in (1e2, 1e4):
        sky = torch.full((1, 32, 128, 3), 0.5)
        sky[:, 9, 64] = strength
        losses.append(float(loss_of_sky(network, sky, AutoencoderConfig())))
    assert losses[0] == pytest.approx(losses[1], rel=1e-6)
    assert not torch.allclose(seen[0][:, -5:], seen[1][:, -5:])


def corrupted(config: AutoencoderConfig) -> Corruption:
    return draw_corruption(3, (32, 128), torch.Generator().manual_seed(1), config)


@pytest.mark.parametrize(
    "config",
    [
        AutoencoderConfig(noise_sigma=0.1),
        AutoencoderConfig(noise_sigma=0.0, masked=0.3),
        AutoencoderConfig(noise_sigma=0.0, sun_noise=0.1),
    ],
)
def test_the_encoder_sees_the_corruption_and_the_loss_does_not(config: AutoencoderConfig) -> None:
    network = ConvolutionalAutoencoder(sun=True).eval()
    seen = []
    coded = torch.zeros(3, 3, 32, 128)
    network.encode_coded = lambda *parts: seen.append(parts) or torch.zeros(3, 64)  # type: ignore
    network.decode_coded = lambda z: coded  # type: ignore[method-assign]
    sky = torch.rand(3, 32, 128, 3, generator=torch.Generator().manual_seed(0))
    corruption = corrupted(config)
    losses = [loss_of_sky(network, sky, config, c) for c in (None, corruption)]
    torch.testing.assert_close(losses[0], losses[1], rtol=0, atol=0)
    (sun, clean), (shaken, dirty) = seen
    torch.testing.assert_close(dirty, corruption.kept * (clean + corruption.noise))
    torch.testing.assert_close(shaken, sun + corruption.sun)
    assert not (torch.equal(dirty, clean) and torch.equal(shaken, sun))


def test_noise_and_penalty_are_of_the_latents_but_the_suns() -> None:
    network = ConvolutionalAutoencoder(sun=True).eval()
    seen = []
    coded = torch.zeros(3, 3, 32, 128)
    latents = torch.arange(64.0).expand(3, -1)
    network.encode_coded = lambda *_: latents  # type: ignore[method-assign]
    network.decode_coded = lambda z: seen.append(z) or coded  # type: ignore[method-assign]
    sky = torch.rand(3, 32, 128, 3, generator=torch.Generator().manual_seed(0))
    plain = AutoencoderConfig(latent_noise=0.5, sun_noise=0.0)
    drawn = corrupted(plain)
    losses = [
        loss_of_sky(network, sky, replace(plain, latent_penalty=p), drawn) for p in (0.0, 0.1)
    ]
    torch.testing.assert_close(seen[0][:, :59], latents[:, :59] + drawn.latents)
    assert 0.3 < float(drawn.latents.std()) < 0.7
    assert torch.equal(seen[0][:, 59:], latents[:, 59:])
    wanted = 0.1 * latents[:, :59].square().mean(1)
    torch.testing.assert_close(losses[1] - losses[0], wanted, rtol=1e-4, atol=0)
