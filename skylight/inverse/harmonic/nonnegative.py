"""Non-negative light in spherical harmonics from the shading of points (thesis, Fig. 7.1)."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.sphere import harmonics
from skylight.sphere.grid import DirectionGrid

CONSTRAINTS = 1024


@dataclass(frozen=True, kw_only=True, eq=False)
class NonNegativeHarmonics:
    """``coefficients`` (k,c) of :func:`skylight.sphere.harmonics.evaluate`, float64.

    ``multipliers`` (j,c), >= 0, of ``Y(w_j) c >= 0``: above 0 only where the light touches 0.
    With ``ridge`` they prove the optimum, ``A^T (A c - s) + ridge c = Y^T multipliers``.
    """

    coefficients: Float[Tensor, "k c"]
    multipliers: Float[Tensor, "j c"]
    ridge: float

    @property
    def degree(self) -> int:
        return harmonics.degree_of(len(self.coefficients))

    def radiance(self, grid: DirectionGrid) -> Float[Tensor, "n c"]:
        """The light in the grid's directions."""
        basis = harmonics.evaluate(grid.directions, self.degree)
        return basis.to(self.coefficients) @ self.coefficients


def nonnegative_harmonics(
    operator: Float[Tensor, "m k"],
    shading: Float[Tensor, "m c"],
    *,
    noise: float = 0.01,
    constraints: DirectionGrid | None = None,
) -> NonNegativeHarmonics:
    """``argmin_c |A c - s|^2 + r |c|^2`` subject to ``sum_lm Y_lm(w_j) c_lm >= 0``, per colour.

    ``operator``
        A: what each harmonic lets the points show, e.g.
        ``TransportMatrix.project(harmonics.evaluate(grid.directions, 4))`` times the albedo.
    ``noise``
        Standard deviation of the shading's errors relative to its root mean square. It sets the
        ridge to ``noise^2 |A|_F^2 / m``, the best for coefficients of equal variance.
    ``constraints``
        The w_j, 1024 Hammersley directions if not given. Between them the light may fall below 0
        by at most 5 % of its range at degree 4 (Bernstein), and 0.6 % in our tests.

    The problem is turned into one of least distance, ``min |z|`` with ``E z >= h`` where
    ``z = R c - f``, ``[A; sqrt(r) I] = Q R`` and ``f = Q^T [s; 0]``, and that into non-negative
    least squares (Lawson and Hanson 1974, 23.4: LSI and LDP). It has one solution.
    """
    grid = constraints or DirectionGrid.hammersley(CONSTRAINTS)
    degree = harmonics.degree_of(operator.shape[1])
    matrix, right = operator.double(), shading.double()
    if not bool(matrix.isfinite().all()) or not bool(right.isfinite().all()):
        raise InputError("shading or transfer have values that are NaN or infinite")
    count = matrix.shape[1]
    ridge = noise**2 * float(matrix.square().sum()) / len(matrix)
    stacked = torch.cat([matrix, math.sqrt(ridge) * torch.eye(count).to(matrix)])
    orthogonal, triangle = torch.linalg.qr(stacked)
    # what remains is small, and on the CPU
    best = (orthogonal[: len(matrix)].T @ right).cpu()
    triangle = triangle.cpu()
    pivots = triangle.diagonal().abs()
    if not float(pivots.min()) > 1e-7 * float(pivots.max()):
        raise InputError(
            f"the points do not tell {count} harmonics apart: give more points or the noise"
        )
    basis = harmonics.evaluate(grid.directions, degree)
    rows = torch.linalg.solve_triangular(triangle, basis, upper=True, left=False)  # E = Y R^-1
    nearest, multipliers = zip(
        *(_least_distance(rows, -rows @ target, float(target.norm())) for target in best.T),
        strict=True,
    )
    distance = torch.stack(nearest, dim=1)
    return NonNegativeHarmonics(
        coefficients=torch.linalg.solve_triangular(triangle, distance + best, upper=True).to(
            operator.device
        ),
        multipliers=torch.stack(multipliers, dim=1).to(operator.device),
        ridge=ridge,
    )


def _least_distance(
    rows: Float[Tensor, "j k"], least: Float[Tensor, " j"], scale: float
) -> tuple[Float[Tensor, " k"], Float[Tensor, " j"]]:
    """(z of least length with ``rows z >= least``, its multipliers: ``z = rows^T multipliers``).

    There must be one of a length of at most ``scale``.
    """
    if scale == 0:
        return torch.zeros_like(rows[0]), torch.zeros_like(least)
    system = torch.cat([rows.T, least[None] / scale])
    target = np.zeros(len(system))
    target[-1] = 1
    from scipy.optimize import nnls  # takes 0.2 s to import

    weights, _ = nnls(system.numpy(), target)
    # what is left of the target is 1 / (1 + |z|^2), at least 1/2
    left = 1 - float(system[-1] @ torch.from_numpy(weights))
    multipliers = scale / left * torch.from_numpy(weights)
    return rows.T @ multipliers, multipliers
