"""Real spherical harmonics from scipy's complex ones: slow and independent."""

import math

import numpy as np
import torch
from scipy.special import eval_legendre, sph_harm_y


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


def cosine_lobe(degree: int) -> np.ndarray:
    """A_l for every coefficient: 2 pi times the integral of u P_l(u) from 0 to 1."""
    u, weights = np.polynomial.legendre.leggauss(32)
    u, weights = (u + 1) / 2, weights / 2
    bands = [2 * np.pi * np.sum(weights * u * eval_legendre(l, u)) for l in range(degree + 1)]  # noqa: E741
    return np.repeat(bands, 2 * np.arange(degree + 1) + 1)


def irradiance(coefficients: torch.Tensor, normals: torch.Tensor) -> torch.Tensor:
    """(n, c): unoccluded irradiance ``sum_lm A_l L_lm Y_lm(n)`` of (k, c) coefficients."""
    degree = math.isqrt(len(coefficients)) - 1
    basis = real_harmonics(normals.double().numpy(), degree) * cosine_lobe(degree)
    return torch.from_numpy(basis) @ coefficients.double()


def from_convention(numbers: torch.Tensor, convention: str) -> torch.Tensor:
    """(9, 3) coefficients of radiance from 27 numbers as glTF or ARCore have them."""
    m = torch.tensor([0, -1, 0, 1, -2, -1, 0, 1, 2])
    negative = m % 2 == 1 if convention == "arcore" else m < 0
    factors = torch.where(negative, -1.0, 1.0).double()
    if convention == "gltf":
        factors = factors * torch.from_numpy(cosine_lobe(2))
    return numbers.reshape(9, 3) / factors[:, None]
