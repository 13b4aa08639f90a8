"""Filters of free shape within a cap about the zenith, and their turning to where they stand."""

import math

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.optimize import nnls
from torch import Tensor

from skylight.csc.dictionary import project_about_pole, sharpest_a
from skylight.csc.positions import Positions
from skylight.sphere import harmonics, lobes
from skylight.sphere.frame import direction_from_angles
from skylight.sphere.rotation import matrix_from_euler, rotation_blocks, turn_about_pole


class Cap:
    """Gaussians about the nodes of a cap, of which filters are sums: ``d = amounts @ lobes``.

    Nodes lie on a Fibonacci spiral that begins at the zenith, a standard deviation of the Gaussians
    from each other, so that sums of them hold no gaps.
    """

    def __init__(self, radius_rad: float, degree: int) -> None:
        a = sharpest_a(degree)
        # exp(-a^2 theta^2): a variance of 1 / (2 a^2)
        count = max(1, round(4 * math.pi * math.sin(radius_rad / 2) ** 2 * 2 * a**2))
        i = torch.arange(count, dtype=torch.float64)
        sine = math.sin(radius_rad / 2) * torch.sqrt(i / count)  # of half the angle
        self.theta = 2 * torch.asin(sine)
        golden = math.pi * (3 - math.sqrt(5))
        self.nodes = direction_from_angles(math.pi - golden * i, self.theta)
        gaussian = project_about_pole(
            lambda theta, phi: lobes.gaussian(theta, torch.tensor([[[a]]], dtype=torch.float64)),
            degree,
            columns=1,
        )[0]
        # one column of phi says nothing about the orders that are left out
        factors = harmonics.zonal_factors(gaussian)
        norm = gaussian[harmonics.orders(degree) == 0].norm()
        bands = factors / norm
        basis = harmonics.evaluate_about_zenith(self.nodes, degree)
        self.lobes = basis * bands[harmonics.bands(degree)]
        """(n, k), of unit norm."""
        self.taper = torch.cos(math.pi / 2 * self.theta / radius_rad)
        """1 in the middle, 0 on the rim: for patches that are cut out of something."""

    def fit(self, filters: Float[Tensor, "m k"]) -> Float[Tensor, "m n"]:
        """The amounts >= 0 whose sums are nearest to these filters."""
        q, r = np.linalg.qr(self.lobes.T.numpy())
        right = filters.double().numpy() @ q
        rows = [nnls(r, row, maxiter=30 * len(self.nodes))[0] for row in right]
        return torch.from_numpy(np.stack(rows))

    def at(
        self, coefficients: Float[Tensor, " k"], alpha: float, beta: float
    ) -> Float[Tensor, " n"]:
        """Values of a function at the nodes, the cap's middle turned to (alpha, beta)."""
        angles = (torch.tensor(x, dtype=torch.float64) for x in (alpha, beta, 0.0))
        turned = self.nodes[:, [2, 0, 1]] @ matrix_from_euler(*angles).T
        degree = harmonics.degree_of(len(coefficients))
        return harmonics.evaluate_about_zenith(turned[:, [1, 2, 0]], degree) @ coefficients


class Turning:
    """``R_j d_j`` at the places of ``positions``, differentiable in the filters.

    As :func:`skylight.csc.rotated.rotated_filters`, with the blocks of the few rows made once.
    """

    def __init__(self, degree: int, positions: Positions) -> None:
        self.positions = positions
        beta = positions.beta
        zero = torch.zeros_like(beta)
        self._blocks = rotation_blocks(matrix_from_euler(zero, beta, zero), degree)
        self._sizes = [2 * l + 1 for l in range(degree + 1)]  # noqa: E741

    def __call__(
        self, filters: Float[Tensor, "s k"], places: Int[Tensor, "s 3"]
    ) -> Float[Tensor, "s k"]:
        alpha, _, gamma = self.positions.euler(places)
        twisted = turn_about_pole(filters, gamma)
        moved, number = [torch.zeros_like(filters[:0])], [places[:0, 0]]
        for row in places[:, 0].unique().tolist():
            here = torch.nonzero(places[:, 0] == row)[:, 0]
            parts = twisted[here].split(self._sizes, 1)
            turns = (block[row].T for block in self._blocks)
            moved.append(torch.cat([p @ t for p, t in zip(parts, turns, strict=True)], 1))
            number.append(here)
        return turn_about_pole(torch.cat(moved)[torch.cat(number).argsort()], alpha)
