"""Where could the sun be? One small non-negative least-squares problem per direction.

For every direction d above the horizon the face's luminance is explained by light from d alone,
scattered (T) and mirrored by the surface (G), plus about twenty broad ambient lobes over the
sphere, all non-negative::

    min_{a, g, b >= 0}  sum_p w_p (y_p - a T[p, d] - g G[p, d] - sum_j b_j (T A)[p, j])^2

The directions with the smallest residuals initialise the non-linear optimisation.

Several faces under one light have a problem each, since each has its own albedo and exposure.
Energies relative to the face's own add up: each face counts alike, as in the objective.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight.sphere.envmap import luminance
from skylight.sphere.grid import DirectionGrid
from skylight.transport.matrix import TransportMatrix
from skylight.transport.observation import Observation

SCAN_HEIGHT = 32
LOBES = 20
RAISES = 3
SETTLED = 1e-3  # of the largest part; the best residuals are then right to 2 in 1,000


@dataclass(frozen=True, kw_only=True)
class SunScan:
    """Relative residual per direction, and the best directions that lie apart.

    ``residuals`` (n,) are sqrt(min / sum w y^2) for each of ``directions`` (n,3), the root mean
    square where there are several faces; ``candidates`` (k,3) the best in order, each 12 degrees
    or more from the better ones (not necessarily local minima), ``strengths`` (k,) the share of
    the diffuse shading that the sun explains in each, a mean over the faces. ``faces`` holds
    the scan of each.
    """

    directions: Float[Tensor, "n 3"]
    residuals: Float[Tensor, " n"]
    candidates: Float[Tensor, "k 3"]
    strengths: Float[Tensor, " k"]
    faces: "tuple[FaceScan, ...]"


def scan_sun(
    observations: Observation | Sequence[Observation],
    *,
    candidates: int = 4,
    separation_deg: float = 12.0,
) -> SunScan:
    """Solve the problem above for all 1,024 directions of the upper half of a 32 x 64 grid.

    Several observations are faces under the same light, whatever their albedos and exposures.
    Each face is solved on the device of its observation; the rest of the answer is on the CPU.
    """
    if isinstance(observations, Observation):
        observations = (observations,)
    faces = [scan_face(observation) for observation in observations]
    energy = torch.stack([face.unexplained for face in faces]).mean(0)
    strength = torch.stack([face.strengths for face in faces]).mean(0)
    residuals = energy.sqrt().cpu()
    grid = DirectionGrid.latlong(SCAN_HEIGHT)
    directions = grid.directions[: len(grid) // 2]
    chosen = _best_apart(directions, residuals, candidates, math.radians(separation_deg))
    return SunScan(
        directions=directions,
        residuals=residuals,
        candidates=directions[chosen],
        strengths=strength.cpu()[chosen],
        faces=tuple(faces),
    )


@dataclass(frozen=True, kw_only=True)
class FaceScan:
    """The problem above for one face.

    ``unexplained`` (n,) the share of sum w y^2 that is left with the sun in each direction,
    ``unlit`` that without any sun; ``strengths`` (n,) the sun's share of the diffuse shading;
    ``deviations`` (m,) luminance seen minus that of the best explanation.
    """

    unexplained: Float[Tensor, " n"]
    unlit: float
    strengths: Float[Tensor, " n"]
    deviations: Float[Tensor, " m"]


def scan_face(observation: Observation) -> FaceScan:
    """Explain one face by a sun in each direction, and by ambient light alone."""
    root = observation.weights.double().sqrt()
    y = luminance(observation.pixels).double() * root
    coarse = observation.on_rows(SCAN_HEIGHT)
    grid = coarse.transport.grid
    upper = len(grid) // 2

    def columns(transport: TransportMatrix) -> Float[Tensor, "m n"]:
        return transport.matrix.double() * root[:, None]

    def suns(transport: TransportMatrix) -> Float[Tensor, "m n_1"]:
        """One problem for each direction, and a last one without a sun."""
        return torch.nn.functional.pad(_unit(columns(transport)[:, :upper]), (0, 1))

    diffuse = columns(coarse.transport)
    groups = [suns(coarse.transport)]
    if coarse.gloss is not None:
        groups.append(suns(coarse.gloss))
    ambient = _unit(diffuse @ _ambient_lobes(grid).to(diffuse))
    clipped = torch.zeros_like(y, dtype=torch.bool)
    if observation.clipped is not None:
        clipped = observation.clipped
    explained = _explain(torch.stack(groups), ambient, y, clipped)
    energy = float(y @ y)
    unexplained = explained.squared.clamp(min=0) / energy
    best = int(unexplained[:-1].argmin())
    return FaceScan(
        unexplained=unexplained[:-1],
        unlit=float(unexplained[-1]),
        strengths=(explained.x[:, 0] * (groups[0].sum(0) / y.sum()))[:-1],
        deviations=explained.deviations(best) / root.clamp(min=1e-12),
    )


@dataclass(frozen=True, kw_only=True)
class _Explained:
    """n problems: ``x`` (n,k) the suns' parts and the ambient ones, ``squared`` what is left."""

    x: Float[Tensor, "n k"]
    squared: Float[Tensor, " n"]
    suns: Float[Tensor, "g m n"]
    ambient: Float[Tensor, "m j"]
    y: Float[Tensor, " m"]
    clipped: Bool[Tensor, " m"]

    def deviations(self, problem: int) -> Float[Tensor, " m"]:
        """Seen less explained; none where a bound is kept."""
        g = len(self.suns)
        shaded = self.suns[:, :, problem].T @ self.x[problem, :g]
        left = self.y - shaded - self.ambient @ self.x[problem, g:]
        return torch.where(self.clipped, left.clamp(min=0), left)


def _explain(
    suns: Float[Tensor, "g m n"],
    ambient: Float[Tensor, "m j"],
    y: Float[Tensor, " m"],
    clipped: Bool[Tensor, " m"],
) -> _Explained:
    """min_{x >= 0} |y - sum_g suns[g, :, d] x_g - ambient x|^2 for each d.

    Where ``clipped``, y is a lower bound: it is raised to what explains it and the problem is
    solved anew, :data:`RAISES` times, which never makes the error larger.
    """
    g, count = len(suns), suns.shape[2]
    gram = y.new_zeros(count, g + ambient.shape[1], g + ambient.shape[1])
    gram[:, :g, :g] = torch.einsum("gmn,hmn->ngh", suns, suns)
    gram[:, :g, g:] = torch.einsum("gmn,mj->ngj", suns, ambient)
    gram[:, g:, :g] = gram[:, :g, g:].transpose(1, 2)
    gram[:, g:, g:] = ambient.T @ ambient
    right = torch.cat([torch.einsum("gmn,m->ng", suns, y), (ambient.T @ y).expand(count, -1)], 1)
    energy = (y @ y).expand(count)
    x = nnls(gram, right, tolerance=SETTLED)
    high, bound = suns[:, clipped], y[clipped]
    raised, level = right, energy
    for raises in range(RAISES + 1 if len(bound) else 0):
        if raises:
            x = nnls(gram, raised, start=x, tolerance=SETTLED)
        shaded = torch.einsum("gmn,ng->mn", high, x[:, :g]) + ambient[clipped] @ x[:, g:].T
        excess = (shaded - bound[:, None]).clamp(min=0)
        more = torch.cat([torch.einsum("gmn,mn->ng", high, excess), excess.T @ ambient[clipped]], 1)
        raised, level = right + more, energy + (excess * (excess + 2 * bound[:, None])).sum(0)
    squared = level - 2 * (raised * x).sum(1) + torch.einsum("nj,njk,nk->n", x, gram, x)
    return _Explained(x=x, squared=squared, suns=suns, ambient=ambient, y=y, clipped=clipped)


def nnls(
    gram: Float[Tensor, "b k k"],
    right: Float[Tensor, "b k"],
    *,
    start: Float[Tensor, "b k"] | None = None,
    sweeps: int = 150,
    tolerance: float = 1e-9,
) -> Float[Tensor, "b k"]:
    """min_{x >= 0} x^T G x / 2 - r^T x for many small problems, by coordinate descent.

    Franc, Hlavac & Navara (2005): each sweep sets every unknown to its own minimum in turn;
    the objective never rises, and stops falling at the solution (G positive semi-definite with
    a positive diagonal; unknowns whose row and right side are zero keep their start). Ends early
    once a sweep moves nothing by more than ``tolerance``, relative to the largest unknown.
    """
    # one unknown of all problems at a time, together in memory
    x = (torch.zeros_like(right) if start is None else start).T.clone(
        memory_format=torch.contiguous_format
    )
    columns = gram.permute(2, 1, 0).contiguous()
    slope = torch.einsum("kjb,kb->jb", columns, x) - right.T
    inverse = 1 / gram.diagonal(dim1=1, dim2=2).clamp(min=1e-30).T.contiguous()
    for _ in range(sweeps):
        before = x.clone()
        for value, steep, scale, column in zip(x, slope, inverse, columns, strict=True):
            new = torch.addcmul(value, steep, scale, value=-1).clamp_(min=0)
            slope.addcmul_(new - value, column)
            value.copy_(new)
        if float((x - before).abs().max()) <= tolerance * float(x.abs().max()):
            break
    return x.T


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
