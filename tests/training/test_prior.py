import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from skylight.errors import AssetError, InputError
from skylight.models.autoencoder import LATENT, SkyAutoencoder
from skylight.models.prior import GaussianMixture
from skylight.skies.index import folder_hash, read_index
from skylight.skies.loading import load_skies
from skylight.training.autoencoder import save_network
from skylight.training.config import PriorConfig
from skylight.training.prior import fit_priors


@pytest.fixture(scope="module")
def network() -> SkyAutoencoder:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return SkyAutoencoder().eval()


@pytest.fixture(scope="module")
def config(
    network: SkyAutoencoder, sky_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> PriorConfig:
    out = tmp_path_factory.mktemp("prior")
    save_network(network, out / "model.safetensors")
    return PriorConfig(
        data=sky_folder,
        checkpoint=out / "model.safetensors",
        out=out,
        most_components=2,
        bank=48,
    )


@pytest.fixture(scope="module")
def fitted(config: PriorConfig) -> Path:
    return fit_priors(config)


def test_report_holds_the_choice_and_the_data(fitted: Path, config: PriorConfig) -> None:
    report = json.loads((fitted / "report.json").read_text())
    assert report["data_sha256"] == folder_hash(config.data, read_index(config.data))
    rows = read_index(config.data)
    for name in ("latent", "sunsky"):
        tried = report[name]["validation_by_components"]
        assert set(tried) == {"1", "2"}
        likelihood = report[name]["mean_log_likelihood"]
        assert set(likelihood) == {"train", "validation", "test"}
        kept = GaussianMixture.load(fitted / f"{name}_prior.safetensors")
        best = min(tried, key=lambda k: tried[k]["bic"])
        assert len(kept.weights) == int(best)
        assert likelihood["validation"] == tried[best]["mean_log_likelihood"]
        # BIC = parameters ln n - 2 sum log p, counted from the mixture's own tensors
        size, count = kept.means.shape[1], sum(r.split == "validation" for r in rows)
        parameters = len(kept.weights) * (1 + size + size * (size + 1) / 2) - 1
        bic = parameters * math.log(count) - 2 * count * likelihood["validation"]
        assert tried[best]["bic"] == pytest.approx(bic)


def test_mixtures_are_over_all_parameters_but_the_azimuth(fitted: Path) -> None:
    assert GaussianMixture.load(fitted / "latent_prior.safetensors").means.shape[1] == LATENT
    assert GaussianMixture.load(fitted / "sunsky_prior.safetensors").means.shape[1] == 9


def test_bank_whitens_and_remembers_the_training_skies(
    fitted: Path, config: PriorConfig, network: SkyAutoencoder
) -> None:
    state = load_file(fitted / "sky_bank.safetensors")
    rows = [r for r in read_index(config.data) if r.split == "train"]
    with torch.no_grad():
        latents = network.encode(load_skies(config.data, rows))
    torch.testing.assert_close(state["latent_mean"], latents.mean(0), rtol=1e-4, atol=1e-4)
    wanted = torch.cov(latents.T) + 1e-4 * torch.eye(LATENT)
    scale = state["latent_scale"]
    torch.testing.assert_close(scale @ scale.T, wanted, rtol=1e-3, atol=1e-5)
    assert torch.equal(scale, scale.tril())
    # every sky of the bank is a training sky, beside the height of its own sun
    zenith = torch.tensor([r.sun_zenith_deg for r in rows]).deg2rad()
    for one, height in zip(state["bank"], state["bank_zenith_rad"], strict=True):
        match = int((latents - one).abs().amax(1).argmin())
        torch.testing.assert_close(latents[match], one, rtol=1e-4, atol=1e-4)
        assert float(zenith[match]) == pytest.approx(float(height), abs=1e-6)
    per_bin = torch.bincount((state["bank_zenith_rad"] / (torch.pi / 48)).long())
    assert 1 <= int(per_bin.max()) <= 2


def test_same_seed_same_files(fitted: Path, config: PriorConfig, tmp_path: Path) -> None:
    again = fit_priors(replace(config, out=tmp_path))
    for name in ("latent_prior", "sunsky_prior", "sky_bank"):
        file = f"{name}.safetensors"
        assert (again / file).read_bytes() == (fitted / file).read_bytes()


def test_what_is_missing_is_named(config: PriorConfig, tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="no checkpoint there"):
        fit_priors(replace(config, checkpoint=tmp_path / "none.safetensors", out=tmp_path))
    index = (config.data / "index.csv").read_text().splitlines()
    row = next(row for row in index if ",train," in row)
    (tmp_path / "index.csv").write_text(f"{index[0]}\n{row}\n")
    with pytest.raises(InputError, match="none falls to validation, test"):
        fit_priors(replace(config, data=tmp_path))
