import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import load_file
from sklearn.covariance import ledoit_wolf

from skylight.errors import AssetError, InputError
from skylight.models._bundle import load_bundle, load_network, save_network
from skylight.models._convolutional import LATENT
from skylight.models._network import SkyNetwork
from skylight.models._prior import GaussianMixture
from skylight.models._splines import SplineAutoencoder
from skylight.models.autoencoder import AutoencoderLight
from skylight.skies._index import folder_hash, load_skies, read_index
from skylight.training._config import PriorConfig
from skylight.training._prior import best_mixture, fit_priors, shrunk_covariance, splits_for_priors


@pytest.fixture(scope="module")
def config(sky_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> PriorConfig:
    out = tmp_path_factory.mktemp("prior")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        save_network(SplineAutoencoder(), out / "model.safetensors")
    return PriorConfig(
        data=sky_folder,
        checkpoint=out / "model.safetensors",
        out=out,
        most_components=2,
        bank=48,
    )


@pytest.fixture(scope="module")
def network(config: PriorConfig) -> SkyNetwork:
    return load_network(config.checkpoint)


@pytest.fixture(scope="module")
def fitted(config: PriorConfig) -> Path:
    shown: list[tuple[str, float]] = []
    out = fit_priors(config, progress=lambda *each: shown.append(each))
    for stage in ("reading skies, set", "encoding skies", "fitting suns and skies"):
        assert any(name.startswith(stage) and share == 0 for name, share in shown)
    return out


def test_the_bundle_is_whole_and_says_where_it_comes_from(
    fitted: Path, config: PriorConfig, network: SkyNetwork
) -> None:
    bundle = load_bundle(fitted)
    rows = read_index(config.data)
    assert bundle.data_sha256 == folder_hash(config.data, rows)
    assert bundle.skies == sum(r.split == "train" for r in rows)
    report = json.loads((fitted / "report.json").read_text())
    card = (fitted / "card.md").read_text()
    for name in ("latent", "sunsky"):
        for value in report[name]["mean_log_likelihood"].values():
            assert f" {value:.1f} |" in card
    assert bundle.data_sha256 in card
    with Image.open(fitted / "reconstructions.png") as picture:
        assert picture.size[1] == 2 * 32
    x = bundle.light().starts()[:, :LATENT]
    assert torch.equal(bundle.network.decode(x), network.decode(x))


def test_the_number_of_components_is_that_of_the_least_bic() -> None:
    """Of two clusters; BIC counted from the mixture's own tensors."""
    generator = torch.Generator().manual_seed(0)
    samples = {}
    for name, count in (("train", 400), ("validation", 60), ("test", 60)):
        x = torch.randn(count, 3, generator=generator).double()
        x[::2, 0] += 12
        samples[name] = x
    shown: list[str] = []
    kept, scores = best_mixture(
        samples, PriorConfig(most_components=4), lambda stage, share: shown.append(stage)
    )
    assert shown[0] == "mixture 0 of 4"
    assert len(kept.weights) == scores["components"] == 2
    tried = scores["validation_by_components"]
    assert set(tried) == {1, 2, 3, 4}
    held_out = float(kept.log_prob(samples["validation"]).mean())
    bic = (2 * (1 + 3 + 6) - 1) * math.log(60) - 2 * 60 * held_out
    assert tried[2]["bic"] == pytest.approx(bic)
    assert bic == min(each["bic"] for each in tried.values())


def test_few_samples_give_one_wide_gaussian() -> None:
    """30 samples in 64 dimensions: unseen ones of the same kind are likely, not 100 sigmas off."""
    generator = torch.Generator().manual_seed(0)
    spread = torch.linspace(0.2, 3, LATENT).double()
    draws = {
        name: torch.randn(30, LATENT, generator=generator).double() * spread
        for name in ("train", "validation", "test")
    }
    kept, scores = best_mixture(draws, PriorConfig())
    assert scores["components"] == 1
    truth = torch.distributions.Normal(torch.zeros(LATENT).double(), spread)
    best = float(truth.log_prob(draws["test"]).sum(1).mean())
    found = float(kept.log_prob(draws["test"]).mean())
    assert best - 40 < found <= best


@pytest.mark.parametrize("count", [8, 50, 2000])
def test_shrunk_covariance_is_ledoit_and_wolfs(count: int) -> None:
    samples = torch.randn(count, 6, generator=torch.Generator().manual_seed(1)).double()
    samples[:, 0] *= 4
    wanted = ledoit_wolf(samples.numpy())[0]
    np.testing.assert_allclose(shrunk_covariance(samples), wanted, rtol=1e-9)


def test_mixtures_are_over_all_parameters_but_the_azimuth(fitted: Path) -> None:
    assert GaussianMixture.load(fitted / "latent_prior.safetensors").means.shape[1] == LATENT
    assert GaussianMixture.load(fitted / "sunsky_prior.safetensors").means.shape[1] == 9


def test_bank_whitens_and_remembers_the_training_skies(
    fitted: Path, config: PriorConfig, network: SkyNetwork
) -> None:
    state = load_file(fitted / "bank.safetensors")
    rows = [r for r in read_index(config.data) if r.split == "train"]
    with torch.no_grad():
        latents = network.encode(load_skies(config.data, rows))
    torch.testing.assert_close(state["latent_mean"], latents.mean(0), rtol=1e-4, atol=1e-4)
    wanted = ledoit_wolf(latents.double().numpy())[0] + 1e-4 * np.eye(LATENT)
    scale = state["latent_scale"]
    np.testing.assert_allclose(scale @ scale.T, wanted, rtol=1e-3, atol=1e-5)
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
    for name in ("latent_prior", "sunsky_prior", "bank", "network"):
        file = f"{name}.safetensors"
        assert (again / file).read_bytes() == (fitted / file).read_bytes()


def test_what_is_missing_is_named(config: PriorConfig, tmp_path: Path) -> None:
    with pytest.raises(AssetError, match=r"none\.safetensors"):
        fit_priors(replace(config, checkpoint=tmp_path / "none.safetensors", out=tmp_path))
    index = (config.data / "index.csv").read_text().splitlines()
    row = next(row for row in index if ",train," in row)
    (tmp_path / "index.csv").write_text(f"{index[0]}\n{row}\n")
    with pytest.raises(InputError, match="validation, test"):
        fit_priors(replace(config, data=tmp_path))


def test_suns_below_the_horizon_do_not_count_for_the_bank(config: PriorConfig) -> None:
    """The skies that an estimate starts from have their suns up: six are wanted."""
    few = [replace(record, sun_zenith_deg=95.0) for record in read_index(config.data)]
    with pytest.raises(InputError, match="0 of them"):
        splits_for_priors(config, few)
    up = 0
    for number, record in enumerate(few):
        if record.split == "train" and up < AutoencoderLight.candidates:
            few[number] = replace(record, sun_zenith_deg=10.0 + 10.0 * up)
            up += 1
    assert len(splits_for_priors(config, few)["train"]) > up
