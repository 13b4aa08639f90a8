"""The model card of a light model that training wrote."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from skylight.io.bounded import json_content
from skylight.models.bundle import LightBundle
from skylight.skies.index import SkyRecord
from skylight.skies.splits import SUNNY

RECONSTRUCTIONS = "reconstructions.png"


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
        "`skylight estimate --model FOLDER`.",
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
