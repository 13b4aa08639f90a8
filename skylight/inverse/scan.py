"""Where could the sun be? One small non-negative least-squares problem per direction.

For every direction d above the horizon the face's luminance is explained by light from d alone,
scattered (T) and mirrored by the surface (G), plus about twenty broad ambient lobes over the
sphere, all non-negative:

    min_{a, g, b >= 0}  sum_p w_p (y_p - a T[p, d] - g G[p, d] - sum_j b_j (T A)[p, j])^2

The directions with the smallest residuals are where non-linear optimisation should start.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.sphere.envmap import luminance
from skylight.sphere.grid import DirectionGrid
from skylight.transport.matrix import TransportMatrix
from skylight.transport.observation import Observation

SCAN_HEIGHT = 32
LOBES = 20


@dataclass(frozen=True, kw_only=True)
class SunScan:
    """Relative residual per direction, and the best directions that lie apart.

    ``residuals`` (n,) are sqrt(min / sum w y^2) for each of ``directions`` (n,3);
    ``candidates`` (k,3) the best in order, each 12 degrees or more from the better ones (not
    necessarily local minima), ``strengths`` (k,) the share of the diffuse shading
    that the sun explains in each.
    """

    directions: Float[Tensor, "n 3"]
    residuals: Float[Tensor, " n"]
    candidates: Float[Tensor, "k 3"]
    strengths: Float[Tensor, " k"]


def scan_sun(
    observation: Observation, *, candidates: int = 4, separation_deg: float = 12.0
) -> SunScan:
    """Solve the problem above for all 1,024 directions of the upper half of a 32 x 64 grid."""
    fine = observation.transport.grid
    if fine.layout is None or fine.layout[0] % SCAN_HEIGHT:
        raise ValueError(f"the transport's grid {fine.layout} must be a multiple of 32 rows")
    root = observation.weights.double().sqrt()
    y = luminance(observation.pixels).double() * root
    grid = DirectionGrid.latlong(SCAN_HEIGHT)
    upper = len(grid) // 2

    def columns(transport: TransportMatrix) -> Float[Tensor, "m n"]:
        # a direction of the coarse grid sends the same radiance from all fine pixels in it
        block = fine.layout[0] // SCAN_HEIGHT  # type: ignore[index]
        cells = transport.matrix.reshape(len(y), SCAN_HEIGHT, block, 2 * SCAN_HEIGHT, block)
        return cells.sum((2, 4)).reshape(len(y), -1).double() * root[:, None]

    diffuse = columns(observation.transport)
    groups = [_unit(diffuse[:, :upper])]
    if observation.gloss is not None:
        groups.append(_unit(columns(observation.gloss)[:, :upper]))
    ambient = _unit(diffuse @ _ambient_lobes(grid))
    k = len(groups)
    gram = torch.zeros(upper, k + LOBES, k + LOBES, dtype=torch.float64)
    right = torch.zeros(upper, k + LOBES, dtype=torch.float64)
    gram[:, k:, k:], right[:, k:] = ambient.T @ ambient, ambient.T @ y
    for i, group in enumerate(groups):
        right[:, i] = group.T @ y
        gram[:, i, k:] = gram[:, k:, i] = group.T @ ambient
        for j, other in enumerate(groups):
            gram[:, i, j] = (group * other).sum(0)
    x = nnls(gram, right)
    energy = float(y @ y)
    squared = energy - 2 * (right * x).sum(1) + torch.einsum("nj,njk,nk->n", x, gram, x)
    residuals = (squared.clamp(min=0) / energy).sqrt()
    explained = x[:, 0] * (groups[0].sum(0) / y.sum())
    directions = grid.directions[:upper]
    chosen = _best_apart(directions, residuals, candidates, math.radians(separation_deg))
    return SunScan(
        directions=directions,
        residuals=residuals,
        candidates=directions[chosen],
        strengths=explained[chosen],
    )


def nnls(
    gram: Float[Tensor, "b k k"], right: Float[Tensor, "b k"], *, sweeps: int = 150
) -> Float[Tensor, "b k"]:
    """min_{x >= 0} x^T G x / 2 - r^T x for many small problems, by coordinate descent.

    Franc, Hlavac & Navara (2005): each sweep sets every unknown to its own minimum in turn;
    the objective never rises, and stops falling at the solution (G positive semi-definite with
    a positive diagonal). Ends early once a sweep moves nothing by more than 1e-9 relative.
    """
    x = torch.zeros_like(right)
    slope = -right.clone()
    diagonal = gram.diagonal(dim1=1, dim2=2).clamp(min=1e-30)
    for _ in range(sweeps):
        moved = 0.0
        for k in range(x.shape[1]):
            new = (x[:, k] - slope[:, k] / diagonal[:, k]).clamp(min=0)
            delta = new - x[:, k]
            slope += delta[:, None] * gram[:, :, k]
            x[:, k] = new
            moved = max(moved, float(delta.abs().max()))
        if moved <= 1e-9 * float(x.abs().max()):
            break
    return x


def _unit(columns: Float[Tensor, "m n"]) -> Float[Tensor, "m n"]:
    """Columns of unit norm, so that all unknowns have about the same scale."""
    return columns / columns.norm(dim=0).clamp(min=1e-12)


def _ambient_lobes(grid: DirectionGrid) -> Float[Tensor, "n k"]:
    """Broad non-negative lobes, ((1 + cos) / 2)^3 round Hammersley directions: 75 degrees wide."""
    centres = DirectionGrid.hammersley(LOBES).directions
    return ((1 + grid.directions @ centres.T) / 2) ** 3


def _best_apart(
    directions: Float[Tensor, "n 3"], values: Float[Tensor, " n"], count: int, separation: float
) -> list[int]:
    """Smallest values first, each at least ``separation`` (radians) from those before it."""
    chosen: list[int] = []
    for i in values.argsort().tolist():
        if all(float(directions[i] @ directions[j]) < math.cos(separation) for j in chosen):
            chosen.append(i)
        if len(chosen) == count:
            break
    return chosen
