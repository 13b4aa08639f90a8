"""Priors over latents and Sun+Sky parameters, written with their network and a model card."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.io._bounded import json_content, write_json
from skylight.models._base import without_azimuth
from skylight.models._bundle import LightBundle, load_network
from skylight.models._network import SkyNetwork
from skylight.models._network_names import network_option
from skylight.models._prior import GaussianMixture, precision_factors_of
from skylight.models.autoencoder import AutoencoderLight
from skylight.models.sunsky import SunSky, fit_sunsky
from skylight.skies._index import SUNNY, SkyRecord, folder_hash, load_skies, read_index
from skylight.training._checkpoint import reconstructions, spread
from skylight.training._config import PriorConfig, config_yaml
from skylight.work._progress import StageProgress, counted, silent

RECONSTRUCTIONS = "reconstructions.png"
# Added to every variance, so that no component collapses on to a few like skies.
COVARIANCE_FLOOR = 1e-2
HEIGHT_BINS = 24
SKIES_PER_DIMENSION = 10
PATIENCE = 2
AT_ONCE = 64  # skies


def model_card(
    bundle: LightBundle,
    splits: Mapping[str, Sequence[SkyRecord]],
    scores: Mapping[str, Any],
    run: Path,
) -> str:
    """Markdown: data, training, priors, limits.

    ``scores`` holds, for the priors "latent" and "sunsky", what :func:`fit_priors` reports;
    ``run`` is the folder of the network's training run, whose ``config.yaml`` and ``curves.json``
    are quoted where they are there.
    """
    records = [record for rows in splits.values() for record in rows]
    sunny = sum(record.sun_transmittance >= SUNNY for record in records)
    days = {name: len({r.day for r in rows}) for name, rows in splits.items()}
    lines = [
        f"# {bundle.name}",
        "",
        f"A light model for inverse lighting outdoors: {bundle.network.latents} latents and an "
        "azimuth to the upper",
        "hemisphere of relative radiance (mean luminance 1), with priors over them. Use it with",
        f"`skylight estimate --model FOLDER{network_option(type(bundle.network))}`.",
        "",
        "## Data",
        "| set | skies | days |",
        "|---|---:|---:|",
        *(f"| {name} | {len(rows)} | {days[name]} |" for name, rows in splits.items()),
        "",
        f"Sunny: {sunny} of {len(records)}. SHA-256 of index and maps: `{bundle.data_sha256}`",
        "",
        "## Training",
        *_configuration(run / "config.yaml"),
        *_curves(run / "curves.json"),
        f"![Validation skies above, their reconstructions below]({RECONSTRUCTIONS})",
        "",
        "## Priors",
        "Gaussian mixtures; mean log-likelihood per sky:",
        "",
        "| prior | components | training | validation | test |",
        "|---|---:|---:|---:|---:|",
        *(_prior(name, scores[name]) for name in ("latent", "sunsky")),
        "",
        "## Limits",
        "The model knows the weather, places and surroundings of its training skies alone.",
    ]
    if len(splits["train"]) < 1000:
        lines.append(
            f"They are {len(splits['train'])}: expect light to be pulled towards those skies."
        )
    return "\n".join(lines) + "\n"


def _configuration(path: Path) -> list[str]:
    if not path.is_file():
        return ["The network's configuration is not known.", ""]
    return ["```yaml", *path.read_text(encoding="utf-8").splitlines(), "```", ""]


def _curves(path: Path) -> list[str]:
    try:
        curves = json_content(path)["curves"]
        rows = [
            f"| {epoch} | {entry['train']:.4f} | {entry['validation']:.4f} "
            f"| {entry['denoising']:.4f} |"
            for epoch, entry in enumerate(curves, 1)
        ]
    except (OSError, ValueError, KeyError, TypeError):
        return []
    head = ["| epoch | training | validation | validation, corrupted |", "|---:|---:|---:|---:|"]
    return [*head, *rows, ""]


def _prior(name: str, scores: Mapping[str, Any]) -> str:
    each = scores["mean_log_likelihood"]
    values = " | ".join(f"{each[split]:.1f}" for split in ("train", "validation", "test"))
    return f"| {name} | {scores['components']} | {values} |"


def fit_priors(
    config: PriorConfig,
    network: type[SkyNetwork] | None = None,
    progress: StageProgress = silent,
) -> Path:
    """Write network, priors and bank into ``config.out`` as a :class:`LightBundle`, with its card.

    ``network`` is the class of the checkpoint's network where that is yours, in place of
    ``config.network``.

    Both priors are over the models' free parameters without the azimuth: for the autoencoder
    these are the latents whitened by the training skies' mean and covariance, the latter shrunk
    by :func:`shrunk_covariance`.

    The number of components is the one of the least BIC on the validation days; ``report.json``
    holds the mean log-likelihood per sky on training, validation and test days.

    Raises
    ------
    InputError
        A split without days, or fewer training skies than an estimate starts from.
    """
    records = read_index(config.data)
    splits = splits_for_priors(config, records)
    trained = load_network(config.checkpoint, network or config.network or None)
    config.out.mkdir(parents=True, exist_ok=True)
    named = counted(list(splits.items()), "reading skies, set", progress)
    skies = {name: load_skies(config.data, rows) for name, rows in named}

    def of_all(make: Callable[[Tensor], Tensor], doing: str) -> dict[str, Tensor]:
        """What is made of the skies of each set, some at a time."""
        batches = {name: batch.split(AT_ONCE) for name, batch in skies.items()}
        flat = counted([part for parts in batches.values() for part in parts], doing, progress)
        return {
            name: torch.cat([make(next(flat)) for _ in parts]).double()
            for name, parts in batches.items()
        }

    with torch.no_grad():
        latents = of_all(trained.encode, "encoding skies, part")
    mean = latents["train"].mean(0)
    scatter = shrunk_covariance(latents["train"]) + 1e-4 * torch.eye(len(mean), dtype=torch.float64)
    scale = torch.linalg.cholesky(scatter)
    white = {
        name: torch.linalg.solve_triangular(scale, (z - mean).T, upper=False).T
        for name, z in latents.items()
    }
    model = SunSky()
    features = of_all(
        lambda part: without_azimuth(model, model.to_free(fit_sunsky(part.flatten(1, 2)))),
        "fitting suns and skies, part",
    )
    latent_prior, latent_scores = best_mixture(white, config, progress)
    sunsky_prior, sunsky_scores = best_mixture(features, config, progress)
    bundle = LightBundle(
        name=config.out.resolve().name,
        skies=len(splits["train"]),
        data_sha256=folder_hash(config.data, records),
        network=trained,
        latent_prior=latent_prior.float(),
        latents={
            "latent_mean": mean.float(),
            "latent_scale": scale.float().contiguous(),
            **_bank(latents["train"], splits["train"], config),
        },
        sunsky_prior=sunsky_prior.float(),
    )
    scores = {"latent": latent_scores, "sunsky": sunsky_scores}
    report = {"data_sha256": bundle.data_sha256, "config": config_yaml(config), **scores}
    write_json(config.out / "report.json", report)
    shown = spread(skies["validation"])
    bundle.save(
        config.out,
        card=model_card(bundle, splits, scores, config.checkpoint.parent),
        pictures={RECONSTRUCTIONS: reconstructions(trained, shown)},
    )
    return config.out


def splits_for_priors(config: PriorConfig, records: list[SkyRecord]) -> dict[str, list[SkyRecord]]:
    """The records of each split, where :func:`fit_priors` can make a light model of them.

    Any number of skies gives a mixture (:func:`best_mixture`), but an estimate starts from
    :attr:`AutoencoderLight.candidates` skies of the bank.
    """
    splits = {
        name: [r for r in records if r.split == name] for name in ("train", "validation", "test")
    }
    if empty := [name for name, rows in splits.items() if not rows]:
        raise InputError(f"{config.data}: too few days: none falls to {', '.join(empty)}")
    found = len(_bank_rows(splits["train"], config))
    if found < AutoencoderLight.candidates:
        raise InputError(
            f"{config.data}: {len(splits['train'])} training skies, {found} of them of use to "
            f"start estimates from, are too few for a light model; at least "
            f"{AutoencoderLight.candidates} are needed, and hundreds are better"
        )
    return splits


def best_mixture(
    samples: dict[str, Float[Tensor, "n p"]],
    config: PriorConfig,
    progress: StageProgress = silent,
) -> tuple[GaussianMixture, dict[str, object]]:
    """The mixture with the least BIC on the validation days; two larger ones that are worse end the
    search.

    BIC = parameters ln n - 2 sum log p, with n and p of the validation skies: what is fitted to
    the training days has to earn its parameters on days that it has not seen. A component takes
    10 training skies per dimension; where they do not suffice for one, it is a single Gaussian
    with :func:`shrunk_covariance`.
    """
    best, least, chosen, tried = None, float("inf"), 0, {}
    count, size = samples["validation"].shape
    most = min(config.most_components, len(samples["train"]) // (SKIES_PER_DIMENSION * size))
    for components in counted(range(1, most + 1), "mixture", progress):
        mixture = GaussianMixture.fit(
            samples["train"], components, seed=config.seed, covariance_floor=COVARIANCE_FLOOR
        )
        held_out = float(mixture.log_prob(samples["validation"]).mean())
        parameters = components * (1 + size + size * (size + 1) // 2) - 1
        bic = parameters * math.log(count) - 2 * count * held_out
        tried[components] = {"bic": bic, "mean_log_likelihood": held_out}
        if bic < least:
            best, least, chosen = mixture, bic, components
        elif components == chosen + PATIENCE:
            break
    if best is None:
        best = _single(samples["train"])
    likelihood = {k: float(best.log_prob(v).mean()) for k, v in samples.items()}
    return best, {
        "components": len(best.weights),
        "mean_log_likelihood": likelihood,
        "validation_by_components": tried,
    }


def _single(samples: Float[Tensor, "n p"]) -> GaussianMixture:
    size = samples.shape[1]
    covariance = shrunk_covariance(samples) + COVARIANCE_FLOOR * torch.eye(size).to(samples)
    factor = precision_factors_of(covariance)
    return GaussianMixture(samples.new_ones(1), samples.mean(0)[None], factor[None])


def shrunk_covariance(samples: Float[Tensor, "n p"]) -> Float[Tensor, "p p"]:
    """``(1 - r) S + r (tr S / p) I``: covariance of few samples (Ledoit & Wolf 2004, eq. 14).

    ::

        r = min(b, d) / d,  d = |S - (tr S / p) I|^2,  b = sum_k |x_k x_k^T - S|^2 / n^2

    with the Frobenius norm, S = sum_k x_k x_k^T / n, and x centred. r vanishes as 1 / n.
    """
    n, p = samples.shape
    x = samples - samples.mean(0)
    covariance = x.T @ x / n
    target = covariance.trace() / p * torch.eye(p).to(x)
    d = (covariance - target).square().sum()
    b = (x.square().sum(1).square().sum() / n - covariance.square().sum()) / n
    r = (b / d.clamp(min=1e-300)).clamp(0, 1)
    return (1 - r) * covariance + r * target


def _bank(
    latents: Float[Tensor, "n z"], records: list[SkyRecord], config: PriorConfig
) -> dict[str, Float[Tensor, "..."]]:
    """Latents and suns of :func:`_bank_rows`."""
    rows = _bank_rows(records, config)
    zenith_deg = torch.tensor([records[row].sun_zenith_deg for row in rows])
    return {
        "bank": latents[torch.tensor(rows)].float().contiguous(),
        "bank_zenith_rad": zenith_deg.deg2rad().float().contiguous(),
    }


def _bank_rows(records: list[SkyRecord], config: PriorConfig) -> list[int]:
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
    return chosen
