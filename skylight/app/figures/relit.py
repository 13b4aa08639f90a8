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
    like = like or environment
    matt_white = white_of(scene.shade(like))
    metal_white = white_of(scene.relight_glossy(like).reshape(-1, 3))
    return (
        tone_map(scene.relight(environment), white=matt_white),
        tone_map(scene.relight_glossy(environment), white=metal_white),
    )
