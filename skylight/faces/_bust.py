"""A bust below a fitted head, which ends at the neck: a superellipsoid (Barr 1981), ::

    |x / a|^(2/e) + |y / b|^(2/e) + |z / c|^(2/e) = 1,

of an adult's proportions, upright, turned half as far as the head. Nothing in the picture is fitted
to it.
"""

import math

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from skylight.faces._fit import FaceFit

SEMI_AXES_M = np.array([0.215, 0.27, 0.115])  # shoulders 43 cm wide: between women's and men's
SQUARENESS = 0.75  # e: 1 is an ellipsoid, towards 0 a box
CENTRE_M = np.array([0.0, -0.44, -0.05])  # from the middle of the head
TURN = 0.5  # of the head's yaw
_RINGS, _SIDES = 24, 48


def bust(fit: FaceFit) -> tuple[Float[ndarray, "n 3"], Int[ndarray, "f 3"]]:
    """Vertices (metres, the camera's frame) and triangles, counter-clockwise from outside."""
    latitudes = np.linspace(-math.pi / 2, math.pi / 2, _RINGS + 1)[1:-1, None]
    longitudes = np.linspace(0, 2 * math.pi, _SIDES, endpoint=False)[None]
    unit = np.stack(
        [
            _power(np.cos(latitudes)) * _power(np.sin(longitudes)),
            np.broadcast_to(_power(np.sin(latitudes)), (_RINGS - 1, _SIDES)),
            _power(np.cos(latitudes)) * _power(np.cos(longitudes)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    points = SEMI_AXES_M * np.concatenate([unit, [[0, -1, 0], [0, 1, 0]]])
    ring = np.arange(len(unit)).reshape(_RINGS - 1, _SIDES)
    beside = np.roll(ring, -1, axis=1)
    bottom, top = np.full(_SIDES, len(unit)), np.full(_SIDES, len(unit) + 1)
    faces = np.concatenate(
        [
            np.stack([ring[:-1], beside[:-1], beside[1:]], -1).reshape(-1, 3),
            np.stack([ring[:-1], beside[1:], ring[1:]], -1).reshape(-1, 3),
            np.stack([bottom, beside[0], ring[0]], -1),
            np.stack([top, ring[-1], beside[-1]], -1),
        ]
    )
    forward = fit.rotation @ np.array([0.0, 0.0, 1.0])
    yaw = TURN * math.atan2(forward[0], forward[2])
    c, s = math.cos(yaw), math.sin(yaw)
    turned = (points + CENTRE_M) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    return turned + fit.translation, faces


def _power(value: Float[ndarray, "*s"]) -> Float[ndarray, "*s"]:
    return np.sign(value) * np.abs(value) ** SQUARENESS
