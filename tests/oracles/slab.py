"""Photons through a plane-parallel cloud that absorbs nothing, in float64, unscaled."""

import numpy as np


def photons_below(
    depth: float, mu0: float, *, g: float, count: int, seed: int = 0
) -> tuple[float, np.ndarray]:
    """(share sent down unscattered or scattered, cosines of the scattered ones leaving below).

    Henyey-Greenstein scattering of asymmetry ``g``, black ground.
    """
    rng = np.random.default_rng(seed)
    tau = np.zeros(count)
    direction = np.tile([np.sqrt(1 - mu0**2), 0.0, mu0], (count, 1))
    scattered = np.zeros(count, bool)
    down, cosines = 0, []
    while len(tau):
        tau = tau + direction[:, 2] * rng.exponential(size=len(tau))
        left_below, left_above = tau > depth, tau < 0
        down += int(left_below.sum())
        cosines.append(direction[left_below & scattered, 2])
        stay = ~(left_below | left_above)
        tau, direction = tau[stay], direction[stay]
        draw = rng.random(len(tau))
        cosine = (1 + g * g - ((1 - g * g) / (1 - g + 2 * g * draw)) ** 2) / (2 * g)
        direction = _turned(direction, cosine, 2 * np.pi * rng.random(len(tau)))
        scattered = np.ones(len(tau), bool)
    return down / count, np.concatenate(cosines)


def _turned(direction: np.ndarray, cosine: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    helper = np.where(np.abs(direction[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    u = np.cross(direction, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(direction, u)
    sine = np.sqrt(np.maximum(0, 1 - cosine**2))
    side = np.cos(azimuth)[:, None] * u + np.sin(azimuth)[:, None] * v
    return cosine[:, None] * direction + sine[:, None] * side
