"""The metrics of the thesis' tables for an estimated environment map."""

import torch
from jaxtyping import Bool
from torch import Tensor

from skylight.imaging.metrics import lighting_metrics, mae, rmse, shading_metrics
from skylight.sphere.envmap import EnvironmentMap
from skylight.transport.scene.evaluation import EvaluationScene, evaluation_scene


def score(
    estimate: EnvironmentMap, truth: EnvironmentMap, *, sun_visible: bool
) -> dict[str, float]:
    """Shading metrics on the evaluation scene and lighting metrics on the probes.

    A picture tells albedo times light, so how bright the light is rests on the skin prior:
    ``brightness`` is the shading's mean over the truth's, and ``mae_aligned`` and
    ``rmse_aligned`` are what is left once it is made 1, the other reading of the thesis'
    "mapping the average image intensity to 1".

    What speaks of the sun (``sun_...``) is left out where none is visible (thesis, 5.5.1).
    """
    scene = evaluation_scene()
    height = truth.layout[0]
    if estimate.layout != truth.layout:
        estimate = estimate.resize(height)
    shaded, true = scene.shade(estimate), scene.shade(truth)
    shading = shading_metrics(scene.matt.image(shaded), scene.matt.image(true), _covered(scene))
    brightness = float(shaded.double().mean() / true.double().mean())
    aligned = shaded / max(brightness, 1e-12)
    shading |= {
        "mae_aligned": mae(aligned, true),
        "rmse_aligned": rmse(aligned, true),
        "brightness": brightness,
    }
    lighting = {
        name: value
        for name, value in lighting_metrics(estimate, truth).items()
        if sun_visible or not name.startswith("sun_")
    }
    return shading | lighting


def _covered(scene: EvaluationScene) -> Bool[Tensor, "h w"]:
    return scene.matt.image(torch.ones(len(scene.matt), 1))[..., 0] > 0
