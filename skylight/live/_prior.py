"""The prior of light and skin, as the moments that a live solution can use.

Live, everything is normal: the ambient light has the mean and covariance of
:class:`~skylight.models._sphere.SphereLight` under its prior, and shading errs by the kernels
below.
"""

import math
from functools import cache

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from skylight.faces._model import HeadModel
from skylight.faces._skin import PIGMENT_SPREADS, pigment_modes
from skylight.live._head import face_points
from skylight.models._sphere import SphereLight, SpherePrior
from skylight.sphere._envmap import luminance
from skylight.sphere._harmonics import project

DEGREE = 4  # of the ambient light's harmonics: 25 of them
_PLACES = 300  # drawn: the variances err by about 8 %
_ROWS = 16
# What shading errs by beside pigments, as part of the face's mean: normals and shadows of a head
# that was fitted, in fields as large as a cheek. Set on rendered people in simulated places.
ERROR_SHARE, ERROR_LENGTH_M, ERROR_MODES = 0.06, 0.03, 24


@cache
def ambient_moments() -> tuple[Float[ndarray, " k"], Float[ndarray, "k k"]]:
    """Mean of the ambient light's luminance, in harmonics of :data:`DEGREE`, and a root R of its
    covariance, R R^T.

    Over the places that skylight knows, each of mean luminance 1 and turned anyhow about the
    vertical, in the camera's frame.
    """
    generator = torch.Generator().manual_seed(0)
    latents = SpherePrior(0).sample(_PLACES, generator)
    turn = 2 * math.pi * torch.rand(_PLACES, 1, generator=generator)
    light = SphereLight(0, _ROWS)
    with torch.no_grad():
        radiance = luminance(light.ambient(torch.cat([latents, turn], 1))).double()
    coefficients = project(radiance.T, light.grid, DEGREE).T.numpy()
    values, vectors = np.linalg.eigh(np.cov(coefficients.T))
    return coefficients.mean(0), vectors * np.sqrt(values.clip(min=0))


@cache
def pigments() -> Float[ndarray, "p k"]:
    """Modes of the logarithm of albedo at :func:`face_points`, of the skin model's spreads."""
    return math.hypot(*PIGMENT_SPREADS) * pigment_modes()[face_points()]


@cache
def shape_errors() -> Float[ndarray, "p k"]:
    """Modes of what shading errs by: kernel ``s^2 exp(-|x - y|^2 / (2 l^2))`` over the face.

    Times the mean luminance; the leading :data:`ERROR_MODES`, with 94 % of the variance.
    """
    places = HeadModel.load().mean[face_points()]
    squared = ((places[:, None] - places) ** 2).sum(2)
    values, vectors = np.linalg.eigh(np.exp(-squared / (2 * ERROR_LENGTH_M**2)))
    leading = slice(None, -ERROR_MODES - 1, -1)
    return ERROR_SHARE * vectors[:, leading] * np.sqrt(values[leading])
