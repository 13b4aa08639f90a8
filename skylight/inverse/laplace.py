"""Laplace's approximation of how likely pictures are under a light model."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.inverse.charbonnier import charbonnier
from skylight.inverse.gauss_newton import Prior, prior_shape

_LEAST_CURVATURE = 1e-3  # of what neither pictures nor priors tell of


@torch.no_grad()
def laplace(
    minimum: Float[Tensor, "b q"],
    deviations: Float[Tensor, "b m"],
    jacobian: Float[Tensor, "b m q"],
    weights: Float[Tensor, "#b m"],
    prior: Prior,
) -> Float[Tensor, " b"]:
    """log of the integral of ``exp(-f)``, with f as in :mod:`skylight.inverse.gauss_newton`::

        -f(x) + q / 2 log(2 pi) - 1/2 log det H(x),    H = J^T diag(w / m) J + Q,

    at minima x of f, with J the derivatives of the deviations r, w what each counts, m their mean
    ``|r|`` and Q the prior's Hessian; w / m are the :func:`curvatures`.

    Each unknown costs the part of its prior that the pictures rule out (MacKay 1992, "Bayesian
    interpolation", Neural Computation 4(3)). Of 30 unknowns and deviations of a half to ten
    hundredths of the mean it is within 7 nats of the integral.
    """
    curved = jacobian * curvatures(deviations, weights)[:, :, None]
    rows = torch.arange(len(minimum), device=minimum.device)
    _, hessian = prior_shape(prior, minimum, rows)
    hessian = hessian.double() + torch.einsum("bmp,bmq->bpq", jacobian, curved).double()
    values = torch.linalg.eigvalsh(hessian).clamp(min=_LEAST_CURVATURE)
    volume = 0.5 * (math.log(2 * math.pi) - values.log()).sum(1)
    data = (charbonnier(deviations) * _exact(deviations, weights)).sum(1)
    return volume - data.double() - prior(minimum, rows).double()


def curvatures(
    deviations: Float[Tensor, "b m"], weights: Float[Tensor, "#b m"]
) -> Float[Tensor, "b m"]:
    """w / m of deviations r that count w, m being their mean ``|r|``.

    ``w |r|`` has a kink at 0: where r has Laplace's density about it, the mean of such terms has
    this curvature; bounds that are kept (r = 0) have none.
    """
    exact = _exact(deviations, weights)
    mean = (charbonnier(deviations) * exact).sum(1, keepdim=True) / exact.sum(1, keepdim=True)
    return exact / mean


def _exact(
    deviations: Float[Tensor, "b m"], weights: Float[Tensor, "#b m"]
) -> Float[Tensor, "b m"]:
    """The weights; 0 of bounds that are kept."""
    return weights * (deviations != 0)
