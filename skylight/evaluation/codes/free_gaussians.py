"""Sums of spherical Gaussians fitted to a map: axes, sharpnesses and colours optimised jointly."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.csc.code import SparseCode
from skylight.csc.coder import SphericalSparseCoder
from skylight.csc.sub_dictionaries import SubDictionary, part_of
from skylight.sphere.grid import DirectionGrid

STEPS = 80
RATE = 0.03
SHARPEST = 4096.0


@dataclass(frozen=True, kw_only=True)
class Lobes:
    """``sum_k rgb_k exp(kappa_k (<d_k, w> - 1))``; a kappa near 0 is a constant."""

    directions: Float[Tensor, "s 3"]
    sharpness: Float[Tensor, " s"]
    colours: Float[Tensor, "s 3"]


def lobes_of(code: SparseCode, coder: SphericalSparseCoder) -> Lobes:
    """The spherical Gaussians nearest to a code of isotropic filters: same centres, same spread.

    A lobe's mean cosine ``m = d_1 / (sqrt 3 d_0)`` gives its sharpness, about
    ``m (3 - m^2) / (1 - m^2)`` (Banerjee et al. 2005, Eq. 4.4).
    """
    parts = [each for each in coder.parts if isinstance(each, SubDictionary)]
    sharpness = []
    for filter_ in code.filters.tolist():
        part = parts[part_of(parts, filter_)]
        if filter_ - part.first >= part.count:  # a pixel
            sharpness.append(SHARPEST)
            continue
        bands = part.bank.coefficients[filter_ - part.first].detach()
        mean = float((bands[2] / (3**0.5 * bands[0])).clamp(0.0, 0.9998))
        sharpness.append(min(SHARPEST, max(1e-2, mean * (3 - mean**2) / (1 - mean**2))))
    return Lobes(
        directions=code.directions,
        sharpness=torch.tensor(sharpness, dtype=torch.float64),
        colours=code.weights,
    )


def fit_gaussians(truth: Float[Tensor, "h w 3"], start: Lobes) -> Float[Tensor, "h w 3"]:
    """The map of the best lobes that descent from ``start`` finds, by the L2 error.

    Directions and log sharpnesses go by Adam; the colours, which may be negative, are the
    least-squares solution of every step (variable projection).
    """
    height, width = truth.shape[:2]
    grid = DirectionGrid.latlong(height, width)
    directions_out = grid.directions.float()
    root = grid.solid_angles.float().sqrt()[:, None]
    target = truth.reshape(-1, 3).float() * root
    target = target / target.norm()
    directions = start.directions.float().clone().requires_grad_()
    sharpness = start.sharpness.float().log().clone().requires_grad_()

    def lobes() -> Float[Tensor, "n s"]:
        unit = torch.nn.functional.normalize(directions, dim=1)
        kappa = sharpness.clamp(max=torch.tensor(SHARPEST).log()).exp()
        return root * torch.exp(kappa * (directions_out @ unit.T - 1))

    def solved(shape: Float[Tensor, "n s"]) -> Float[Tensor, "s 3"]:
        gram = (shape.T @ shape).double()
        ridge = 1e-7 * gram.diagonal().mean() * torch.eye(len(gram), dtype=torch.float64)
        return torch.linalg.solve(gram + ridge, (shape.T @ target).double()).float()

    best, least = None, float("inf")
    optimiser = torch.optim.Adam([directions, sharpness], lr=RATE)
    for _ in range(STEPS):
        optimiser.zero_grad()
        shape = lobes()
        # variable projection: the colours are the best ones, so their own gradient is zero
        colours = solved(shape.detach())
        fit = shape @ colours
        loss = (fit - target).square().sum()
        if loss.item() < least:
            least, best = loss.item(), fit.detach() / root
        loss.backward()
        optimiser.step()
    assert best is not None
    norm = (truth.reshape(-1, 3) * root.double()).norm()
    return (best.double() * norm).reshape(truth.shape)
