"""Renderings of the evaluation scene under an environment map."""

import numpy as np
from jaxtyping import UInt8

from skylight.app.figures.exposure import white_of
from skylight.imaging.colour import tone_map
from skylight.sphere.envmap import EnvironmentMap
from skylight.transport.scene.evaluation import EvaluationScene

SCENE_HEIGHT, SCENE_GRID = 144, 32  # for looking at: twice the scores' pixels, as much memory


def relit(
    scene: EvaluationScene, environment: EnvironmentMap, *, like: EnvironmentMap | None = None
) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]:
    """(matt objects, metal objects) in this light, exposed for them or as in the light ``like``."""
    matt, metal = scene.relight(environment), scene.relight_glossy(environment)
    matt_like = matt if like is None else scene.relight(like)
    metal_like = metal if like is None else scene.relight_glossy(like)
    rows, columns = scene.matt.pixels.unbind(1)
    return (
        tone_map(matt, white=white_of(matt_like[rows, columns])),
        tone_map(metal, white=white_of(metal_like.reshape(-1, 3))),
    )
