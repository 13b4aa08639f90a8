import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.models.autoencoder import SkyAutoencoder, load_network
from skylight.skies.dataset import folder_hash, read_index
from skylight.training import autoencoder as training
from skylight.training.autoencoder import (
    _batch,
    _schedule,
    load_data,
    reconstruction_loss,
    train,
)
from skylight.training.config import AutoencoderConfig, read_config


@pytest.fixture(scope="module")
def config(sky_folder: Path) -> AutoencoderConfig:
    """Two epochs of three steps."""
    return AutoencoderConfig(
        data=sky_folder, epochs=2, batch=4, warmup_steps=1, bfloat16=False, checkpoint_steps=2
    )


@pytest.fixture(scope="module")
def uninterrupted(config: AutoencoderConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole")
    train(replace(config, out=out), report=lambda _: None)
    return out


def state(out: Path) -> dict:
    return torch.load(out / "state.pt", weights_only=True)


def test_data_are_split_by_day_and_cached(sky_folder: Path) -> None:
    data = load_data(sky_folder)
    records = read_index(sky_folder)
    assert len(data.train) == sum(r.split == "train" for r in records)
    assert len(data.validation) == sum(r.split == "validation" for r in records)
    assert data.hash == folder_hash(sky_folder, records)
    assert len(list((sky_folder / ".cache").iterdir())) == 1
    assert torch.equal(load_data(sky_folder).train, data.train)


def test_one_epoch_after_another_learns(uninterrupted: Path, sky_folder: Path) -> None:
    curves = json.loads((uninterrupted / "curves.json").read_text())
    assert curves["data_sha256"] == load_data(sky_folder).hash
    assert [c["step"] for c in curves["curves"]] == [3, 6]
    first, second = (c["train"] for c in curves["curves"])
    assert second < first
    load_network(uninterrupted / "model.safetensors")


def test_a_killed_run_goes_on_bit_by_bit(
    config: AutoencoderConfig,
    uninterrupted: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Killed in step 6, after the checkpoint of step 4: in the middle of an epoch."""
    config = replace(config, out=tmp_path)
    batch = training._batch

    def killed(skies, config, epoch, within):
        if (epoch, within) == (1, 2):
            raise KeyboardInterrupt
        return batch(skies, config, epoch, within)

    monkeypatch.setattr(training, "_batch", killed)
    with pytest.raises(KeyboardInterrupt):
        train(config, report=lambda _: None)
    monkeypatch.undo()
    assert state(tmp_path)["step"] == 4
    torch.randn(100)  # what else the process draws must not matter
    messages: list[str] = []
    train(config, report=messages.append)
    assert messages[0] == "resuming at step 4 of 6"
    for name in ("model.safetensors", "curves.json"):
        assert (tmp_path / name).read_bytes() == (uninterrupted / name).read_bytes()
    ours, theirs = state(tmp_path), state(uninterrupted)
    for name, weight in theirs["network"].items():
        assert torch.equal(ours["network"][name], weight)


def test_a_finished_run_stays_finished(
    config: AutoencoderConfig, uninterrupted: Path, tmp_path: Path
) -> None:
    """Also after its folder has moved, and with other checkpoints: what changes no step."""
    out = tmp_path / "moved"
    shutil.copytree(uninterrupted, out)
    messages: list[str] = []
    train(replace(config, out=out, checkpoint_steps=7), report=messages.append)
    assert messages == ["resuming at step 6 of 6"]
    name = "model.safetensors"
    assert (out / name).read_bytes() == (uninterrupted / name).read_bytes()


def test_another_configuration_is_refused(config: AutoencoderConfig, uninterrupted: Path) -> None:
    with pytest.raises(InputError, match="another configuration"):
        train(replace(config, out=uninterrupted, seed=1))


@pytest.mark.parametrize("content", [b"", b"not a state", None])
def test_damaged_states(
    config: AutoencoderConfig, uninterrupted: Path, tmp_path: Path, content: bytes | None
) -> None:
    whole = (uninterrupted / "state.pt").read_bytes()
    (tmp_path / "state.pt").write_bytes(whole[: len(whole) // 2] if content is None else content)
    with pytest.raises(InputError, match=r"state\.pt: the run's state is damaged") as caught:
        train(replace(config, out=tmp_path))
    assert "\n" not in str(caught.value)


def test_a_state_of_something_else(config: AutoencoderConfig, tmp_path: Path) -> None:
    torch.save({"weights": torch.zeros(1)}, tmp_path / "state.pt")
    with pytest.raises(InputError, match="damaged"):
        train(replace(config, out=tmp_path))


def test_the_written_configuration_repeats_the_run(
    uninterrupted: Path, config: AutoencoderConfig
) -> None:
    assert read_config(uninterrupted / "config.yaml") == replace(config, out=uninterrupted)


def test_early_stopping(
    config: AutoencoderConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After ``patience`` epochs without a better score; the best network is kept."""
    scores = iter([3.0, 2.0, 2.5, 2.5, 1.0])
    monkeypatch.setattr(training, "validate", lambda *_: next(scores))
    config = replace(config, out=tmp_path, epochs=5, patience=2, batch=12)
    train(config, report=lambda _: None)
    curves = json.loads((tmp_path / "curves.json").read_text())["curves"]
    assert [c["validation"] for c in curves] == [3.0, 2.0, 2.5, 2.5]
    assert next(scores) == 1.0


def test_divergence_is_said(config: AutoencoderConfig, tmp_path: Path) -> None:
    config = replace(config, out=tmp_path, learning_rate=math.nan, batch=12)
    with pytest.raises(InputError, match="diverged in epoch 1"):
        train(config)


def test_too_few_skies(config: AutoencoderConfig, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="do not fill a batch of 1000"):
        train(replace(config, out=tmp_path, batch=1000))


def test_a_split_without_days(sky_folder: Path, tmp_path: Path) -> None:
    rows = (sky_folder / "index.csv").read_text().splitlines()
    train_rows = [
        row
        for row, record in zip(rows[1:], read_index(sky_folder), strict=True)
        if record.split == "train"
    ]
    (tmp_path / "index.csv").write_text("\n".join([rows[0], train_rows[0]]) + "\n")
    name = train_rows[0].split(",")[0]
    (tmp_path / name).symlink_to(sky_folder / name)
    with pytest.raises(InputError, match="too few days"):
        load_data(tmp_path)


def test_batches_cover_an_epoch_once_and_differ_between_epochs(
    config: AutoencoderConfig,
) -> None:
    skies = torch.arange(12.0).reshape(12, 1, 1, 1).expand(12, 32, 128, 3)
    seen = [_batch(skies, config, 0, i)[0][:, 0, 0, 0] for i in range(3)]
    assert sorted(torch.cat(seen).tolist()) == list(range(12))
    again, noise = _batch(skies, config, 0, 1)
    assert torch.equal(again[:, 0, 0, 0], seen[1])
    assert torch.equal(noise, _batch(skies, config, 0, 1)[1])
    assert not torch.equal(noise, _batch(skies, config, 0, 2)[1])
    assert not torch.equal(_batch(skies, config, 1, 1)[0][:, 0, 0, 0], seen[1])
    assert float(noise.std()) == pytest.approx(config.noise_sigma, rel=0.02)
    assert float(noise.mean()) == pytest.approx(0, abs=2e-4)


def test_mirroring_keeps_the_sun_in_its_column(config: AutoencoderConfig) -> None:
    skies = torch.rand(8, 32, 128, 3, generator=torch.Generator().manual_seed(0))
    plain, _ = _batch(skies, replace(config, mirror=False), 0, 0)
    mirrored, _ = _batch(skies, config, 0, 0)
    torch.testing.assert_close(mirrored[:, :, 64], plain[:, :, 64], rtol=0, atol=0)
    # column 64 + k of a mirrored sky is column 64 - k of the sky
    reflected = plain[:, :, (64 - (torch.arange(128) - 64)) % 128]
    flipped = [
        torch.equal(m, r) and not torch.equal(m, p)
        for m, r, p in zip(mirrored, reflected, plain, strict=True)
    ]
    kept = [torch.equal(m, p) for m, p in zip(mirrored, plain, strict=True)]
    assert all(a != b for a, b in zip(flipped, kept, strict=True))
    assert 0 < sum(flipped) < 8


def test_schedule() -> None:
    """Up over the warm-up, at its height, half way, and down to 1 %."""
    rates = [_schedule(step, 1010, 10) for step in range(1010)]
    assert rates[0] == pytest.approx(0.1)
    assert rates[9] == pytest.approx(1)
    assert rates[510] == pytest.approx(0.505)
    assert rates[-1] == pytest.approx(0.01, abs=1e-4)
    assert rates[10:] == sorted(rates[10:], reverse=True)


@pytest.mark.parametrize("energy_weight", [0.0, 0.3])
def test_loss_is_its_formula(energy_weight: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """sum_w dw (1 + g max(L, L')) |log(1 + L') - log(1 + L)| / 2 pi, mean over channels."""
    rng = np.random.default_rng(0)
    true, predicted = rng.exponential(2.0, (2, 3, 32, 128, 3))
    network = SkyAutoencoder()
    coded = torch.tensor(np.log1p(predicted)).permute(0, 3, 1, 2).float()
    monkeypatch.setattr(network, "encode_coded", lambda x: x)
    monkeypatch.setattr(network, "decode_coded", lambda _: coded)
    ours = reconstruction_loss(network, torch.tensor(true).float(), coded, energy_weight)
    edges = np.cos(np.linspace(0, np.pi / 2, 33))
    row = (edges[:-1] - edges[1:]) * 2 * np.pi / 128
    each = (1 + energy_weight * np.maximum(true, predicted)) * np.abs(
        np.log1p(predicted) - np.log1p(true)
    )
    expected = (each * row[None, :, None, None]).sum((1, 2)).mean(-1) / (2 * np.pi)
    np.testing.assert_allclose(ours.numpy(), expected, rtol=1e-5)


def test_loss_of_the_truth_is_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    network = SkyAutoencoder()
    clean = torch.rand(2, 32, 128, 3)
    monkeypatch.setattr(network, "encode_coded", lambda x: x)
    monkeypatch.setattr(network, "decode_coded", lambda z: z)
    assert reconstruction_loss(network, clean, network.code(clean), 0.3).tolist() == [0, 0]


def test_validation_is_the_mean_over_skies_whatever_the_batch(
    config: AutoencoderConfig,
) -> None:
    generator = torch.Generator().manual_seed(0)
    skies = torch.rand(5, 32, 128, 3, generator=generator)
    network = SkyAutoencoder()
    scores = [training.validate(network, skies, replace(config, batch=batch)) for batch in (2, 5)]
    assert scores[0] == pytest.approx(scores[1], rel=1e-5)
