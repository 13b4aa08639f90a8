"""Fits the priors over light: mixtures over latents and over Sun+Sky parameters."""

import math
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.imaging.files import write_json
from skylight.imaging.tensors import write_tensors
from skylight.models.autoencoder import load_network
from skylight.models.base import without_azimuth
from skylight.models.prior import GaussianMixture
from skylight.models.sunsky import SunSky, fit_sunsky
from skylight.skies.index import SkyRecord, folder_hash, read_index
from skylight.skies.loading import load_skies
from skylight.training.config import PriorConfig, config_yaml

# Added to every variance, so that no component collapses on to a few like skies.
COVARIANCE_FLOOR = 1e-2
HEIGHT_BINS = 24


def fit_priors(config: PriorConfig) -> Path:
    """Write the two mixtures, the latents' bank and a report into ``config.out``.

    Both mixtures are over the models' free parameters without the azimuth: for the
    autoencoder these are the latents whitened by the training skies' mean and covariance.

    The number of components is the one of the least BIC on the validation days; the report holds
    the mean log-likelihood per sky on training, validation and test days.
    """
    records = read_index(config.data)
    splits = {
        name: [r for r in records if r.split == name] for name in ("train", "validation", "test")
    }
    if empty := [name for name, rows in splits.items() if not rows]:
        raise InputError(f"{config.data}: too few days: none falls to {', '.join(empty)}")
    network = load_network(config.checkpoint)
    config.out.mkdir(parents=True, exist_ok=True)
    skies = {name: load_skies(config.data, rows) for name, rows in splits.items()}
    with torch.no_grad():
        latents = {
            name: torch.cat([network.encode(part) for part in batch.split(64)]).double()
            for name, batch in skies.items()
        }
    mean = latents["train"].mean(0)
    scatter = torch.cov(latents["train"].T) + 1e-4 * torch.eye(len(mean), dtype=torch.float64)
    scale = torch.linalg.cholesky(scatter)
    white = {
        name: torch.linalg.solve_triangular(scale, (z - mean).T, upper=False).T
        for name, z in latents.items()
    }
    model = SunSky()
    features = {
        name: without_azimuth(model, model.to_free(fit_sunsky(batch.flatten(1, 2)))).double()
        for name, batch in skies.items()
    }
    report: dict[str, object] = {
        "data_sha256": folder_hash(config.data, records),
        "config": config_yaml(config),
    }
    for name, samples in (("latent", white), ("sunsky", features)):
        mixture, scores = _best_mixture(samples, config)
        mixture.float().save(config.out / f"{name}_prior.safetensors")
        report[name] = scores
    state = {
        "latent_mean": mean.float(),
        "latent_scale": scale.float().contiguous(),
        **_bank(latents["train"], splits["train"], config),
    }
    write_tensors(config.out / "sky_bank.safetensors", state)
    write_json(config.out / "report.json", report)
    return config.out


def _best_mixture(
    samples: dict[str, Float[Tensor, "n p"]], config: PriorConfig
) -> tuple[GaussianMixture, dict[str, object]]:
    """The mixture with the least BIC on the validation days.

    BIC = parameters ln n - 2 sum log p, with n and p of the validation skies: what is fitted to
    the training days has to earn its parameters on days that it has not seen.
    """
    best, least, tried = None, float("inf"), {}
    count, size = samples["validation"].shape
    for components in range(1, config.most_components + 1):
        mixture = GaussianMixture.fit(
            samples["train"], components, seed=config.seed, covariance_floor=COVARIANCE_FLOOR
        )
        held_out = float(mixture.log_prob(samples["validation"]).mean())
        parameters = components * (1 + size + size * (size + 1) // 2) - 1
        bic = parameters * math.log(count) - 2 * count * held_out
        tried[components] = {"bic": bic, "mean_log_likelihood": held_out}
        if bic < least:
            best, least = mixture, bic
    assert best is not None
    likelihood = {k: float(best.log_prob(v).mean()) for k, v in samples.items()}
    return best, {"mean_log_likelihood": likelihood, "validation_by_components": tried}


def _bank(
    latents: Float[Tensor, "n z"], records: list[SkyRecord], config: PriorConfig
) -> dict[str, Float[Tensor, "..."]]:
    """Training skies evenly spread over the sun's height, those with an open sun first."""
    zenith = torch.tensor([r.sun_zenith_deg for r in records]).deg2rad()
    hidden = torch.tensor([r.sun_transmittance < 0.3 for r in records])
    width = torch.pi / 2 / HEIGHT_BINS
    chosen: list[int] = []
    shuffle = torch.randperm(
        len(records), generator=torch.Generator().manual_seed(config.seed)
    ).tolist()
    for b in range(HEIGHT_BINS):
        inside = [i for i in shuffle if b * width <= float(zenith[i]) < (b + 1) * width]
        inside.sort(key=lambda i: bool(hidden[i]))
        chosen += inside[: config.bank // HEIGHT_BINS]
    index = torch.tensor(chosen)
    return {
        "bank": latents[index].float().contiguous(),
        "bank_zenith_rad": zenith[index].float().contiguous(),
    }
