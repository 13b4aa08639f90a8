"""All scores of a predicted environment map, with its scale as it is and aligned to the truth."""

from typing import Literal, get_args

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.evaluation.scores.three_spheres import angular_error_deg, render_spheres
from skylight.imaging.metrics import (
    lighting_metrics,
    mae,
    rmse,
    shading_metrics,
    si_rmse,
    sun_angle_deg,
)
from skylight.skies.sun_in_map import find_sun
from skylight.sphere.envmap import EnvironmentMap
from skylight.transport.scene.evaluation import evaluation_scene

Alignment = Literal["unaligned", "mean", "least_squares"]
SCALE_FREE = "scale_free"
# metric -> alignment (or SCALE_FREE) -> value
Scores = dict[str, dict[str, float]]


def scale_factor(
    pred: Float[Tensor, "n 3"],
    true: Float[Tensor, "n 3"],
    alignment: Alignment,
    weights: Float[Tensor, " n"] | None = None,
) -> float:
    """The factor on a prediction: 1; sum w t / sum w p; or sum w p t / sum w p^2.

    Over all channels together, so colours are never corrected; 1 for a black prediction.
    """
    if alignment == "unaligned":
        return 1.0
    p, t = pred.double(), true.double()
    w = torch.ones(len(p), 1).double() if weights is None else weights.double()[:, None]
    above, below = (w * t, w * p) if alignment == "mean" else (w * p * t, w * p * p)
    total = float(below.sum())
    return float(above.sum()) / total if total > 0 else 1.0


def score_maps(predicted: EnvironmentMap, truth: EnvironmentMap) -> tuple[Scores, bool]:
    """All metrics, and whether the truth shows a sun; docs/scores.md has the formulas.

    Both are full maps of one size. Pictures of the evaluation scene (``scene_...``), the maps
    themselves (``full_dw_mae`` and its kind) and each sphere are aligned each by its own factor;
    ``brightness`` is the factor by which the prediction is too bright, by the scene's mean. What
    speaks of the sun is left out where the truth shows none (thesis, 5.5.1).

    Raises
    ------
    InputError
        Maps of two sizes, a sky alone, or a black truth.
    """
    if predicted.is_sky or truth.is_sky:
        raise InputError("scores need full maps: give a sky a lower half first")
    if predicted.layout != truth.layout:
        raise InputError(
            f"maps of {predicted.layout} and {truth.layout} pixels: resize one of them"
        )
    if not truth.radiance.sum() > 0:
        raise InputError("the true light is black: there is nothing to compare with")
    scores: Scores = {}
    _score_scene(scores, predicted, truth)
    sun_visible = truth.upper().radiance.sum() > 0 and find_sun(truth.upper()).visible
    _score_light(scores, predicted, truth, sun_visible=bool(sun_visible))
    _score_spheres(scores, predicted, truth)
    return scores, bool(sun_visible)


def _score_scene(scores: Scores, predicted: EnvironmentMap, truth: EnvironmentMap) -> None:
    scene = evaluation_scene()
    shaded, true = scene.shade(predicted), scene.shade(truth)
    covered = scene.matt.image(torch.ones(len(scene.matt), 1))[..., 0] > 0
    shown = scene.matt.image(true)
    for alignment in get_args(Alignment):
        picture = scene.matt.image(shaded * scale_factor(shaded, true, alignment))
        values = shading_metrics(picture, shown, covered)
        for name in ("mae", "rmse", "ssim"):
            scores.setdefault(f"scene_{name}", {})[alignment] = values[name]
    scores["scene_si_rmse"] = {SCALE_FREE: si_rmse(shaded, true)}
    scores["brightness"] = {SCALE_FREE: float(shaded.double().mean() / true.double().mean())}


def _score_light(
    scores: Scores, predicted: EnvironmentMap, truth: EnvironmentMap, *, sun_visible: bool
) -> None:
    factor = scale_factor(predicted.flat, truth.flat, "least_squares", truth.grid.solid_angles)
    fitted = EnvironmentMap(radiance=predicted.radiance * factor)
    values = {
        "unaligned": lighting_metrics(predicted, truth, align_scale=False),
        "mean": lighting_metrics(predicted, truth, align_scale=True),
        "least_squares": lighting_metrics(fitted, truth, align_scale=False),
    }
    for name in values["mean"]:
        if name == "sun_angle_deg" or (name.startswith("sun_") and not sun_visible):
            continue
        scores[name] = {alignment: metrics[name] for alignment, metrics in values.items()}
    if sun_visible:
        scores["sun_angle_deg"] = {SCALE_FREE: sun_angle_deg(predicted, truth)}


def _score_spheres(scores: Scores, predicted: EnvironmentMap, truth: EnvironmentMap) -> None:
    shown, true = render_spheres(predicted), render_spheres(truth)
    for material, picture in shown.items():
        for alignment in get_args(Alignment):
            aligned = picture * scale_factor(picture, true[material], alignment)
            values = scores.setdefault(f"{material}_rmse", {})
            values[alignment] = rmse(aligned, true[material])
            values = scores.setdefault(f"{material}_mae", {})
            values[alignment] = mae(aligned, true[material])
        scores[f"{material}_si_rmse"] = {SCALE_FREE: si_rmse(picture, true[material])}
        scores[f"{material}_angle_deg"] = {SCALE_FREE: angular_error_deg(picture, true[material])}
