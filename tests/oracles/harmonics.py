"""Real spherical harmonics from scipy's complex ones: slow and independent."""

import math

import numpy as np
from scipy.special import sph_harm_y


def real_harmonics(directions: np.ndarray, degree: int) -> np.ndarray:
    """(n, (degree + 1)^2) values; polar axis +Z, azimuth from +X, no Condon-Shortley sign."""
    x, y, z = directions.T
    theta, phi = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    columns = []
    for l in range(degree + 1):  # noqa: E741
        for m in range(-l, l + 1):
            value = (-1) ** m * sph_harm_y(l, abs(m), theta, phi)  # scipy has the sign
            part = value.real if m >= 0 else value.imag
            columns.append(part * (1 if m == 0 else math.sqrt(2)))
    return np.stack(columns, axis=1)
