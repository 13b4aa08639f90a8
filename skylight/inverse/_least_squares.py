"""Many small problems at once: non-negative least squares, and the evidence of robust ones.

:func:`nnls` solves the former, :func:`laplace` approximates the latter.
"""

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.inverse._gauss_newton import Prior, charbonnier

_SWEEPS = 3  # of coordinate descent, after which few pivots are left
_PIVOTS = 4  # of all problems together; what is left then is solved one by one
# Of 22 unknowns one takes a core 22 us by itself, 27 to 45 by pivots; of 4 it is 6 us and 1
_FEW = 8


def nnls(
    gram: Float[Tensor, "b k k"],
    right: Float[Tensor, "b k"],
    *,
    start: Float[Tensor, "b k"] | None = None,
) -> Float[Tensor, "b k"]:
    """argmin_{x >= 0} x^T G x / 2 - r^T x of b problems, by block principal pivoting.

    Unknowns are free or zero. The free ones are those of the unconstrained problem, and all that
    are wrong (free and negative, or zero with a negative slope) change sides, until none is: Kim &
    Park, "Fast nonnegative matrix factorization: an active-set-like method and comparisons", SIAM
    J. Sci. Comput. 33(6), 2011. At first those are free that a few sweeps of coordinate descent
    from ``start`` (by default 0) leave positive; near starts take few pivots.

    G may be singular: 1e-10 of its diagonal is added to it. In single precision, where rounding
    makes it a little indefinite, that is 1e-6 of the largest of the diagonal, which therefore
    should be of one order. A slope of less than 1e-9 of the largest ``|r|`` counts as 0.
    Unknowns whose row and right side are zero are 0. Computed in double precision. Where columns
    are nearly dependent, exchanges may cycle: problems that are left after 4 are solved by an
    active set method, one by one. On a CPU so are all problems of more than 8 unknowns
    (:data:`_FEW`), which ignore ``start``.
    """
    if len(right) == 0:
        return torch.zeros_like(right)
    whole, wanted = gram.double(), right.double()
    diagonal = whole.diagonal(dim1=1, dim2=2)
    if gram.dtype == torch.float64:
        ridge = 1e-10 * diagonal
    else:
        ridge = 1e-6 * diagonal.amax(1, keepdim=True)
    whole = whole + torch.diag_embed(ridge + (diagonal <= 0))
    if right.shape[1] > _FEW and right.device.type == "cpu":
        return (_by_active_set(whole, wanted) * (diagonal > 0)).to(right)
    limit = 1e-9 * wanted.abs().amax(1, keepdim=True)
    free = _descended(whole, wanted, start) > 0
    solution = torch.zeros_like(wanted)
    rows = torch.arange(len(right), device=right.device)  # of what is not solved yet
    for _ in range(_PIVOTS):
        chosen = free.double()
        system = whole * chosen[:, :, None] * chosen[:, None]
        system.diagonal(dim1=1, dim2=2).add_(1 - chosen)
        root, failed = torch.linalg.cholesky_ex(system)
        x = torch.cholesky_solve((wanted * chosen)[..., None], root)
        slope = (whole @ x)[..., 0] - wanted
        x = x[..., 0]
        wrong = torch.where(free, x * diagonal < -limit, slope < -limit)
        solution[rows] = x.clamp(min=0)
        left = wrong.any(1) | (failed > 0)
        if not bool(left.any()):
            break
        free, whole, wanted, diagonal, limit, rows = (
            each[left] for each in (free ^ wrong, whole, wanted, diagonal, limit, rows)
        )
    else:
        solution[rows] = _by_active_set(whole, wanted)
    return solution.to(right)


def _descended(
    gram: Float[Tensor, "b k k"], right: Float[Tensor, "b k"], start: Float[Tensor, "b k"] | None
) -> Float[Tensor, "b k"]:
    """Each unknown in turn at its best for the others, several times."""
    rows, wanted = gram.permute(1, 2, 0).contiguous(), right.T  # unknowns first: whole rows
    x = torch.zeros_like(wanted) if start is None else start.T.to(wanted)
    x = x.clone(memory_format=torch.contiguous_format)
    for _ in range(_SWEEPS):
        for k, row in enumerate(rows):
            slope = (row * x).sum(0) - wanted[k]
            x[k] = (x[k] - slope / row[k]).clamp(min=0)
    return x.T


def _by_active_set(
    gram: Float[Tensor, "b k k"], right: Float[Tensor, "b k"]
) -> Float[Tensor, "b k"]:
    """Each by itself on the CPU, as min |R x - y| with G = R^T R and R^T y = r.

    R is Cholesky's factor. Where rounding made eigenvalues negative there is none: those, or almost
    0, are 1e-10 of the largest.
    """
    from scipy.optimize import nnls as active_set  # takes 0.2 s to import

    # all at once: a GPU would wait for the CPU at every one of thousands of small problems
    gram, target = gram.cpu(), right.cpu()[..., None]
    lower, failed = torch.linalg.cholesky_ex(gram)
    roots, y = lower.mT, torch.linalg.solve_triangular(lower, target, upper=False)
    indefinite = failed > 0
    values, vectors = torch.linalg.eigh(gram[indefinite])
    scales = values.clamp(min=1e-10 * values[:, -1:]).sqrt()[..., None]
    roots[indefinite], y[indefinite] = scales * vectors.mT, vectors.mT @ target[indefinite] / scales
    found = [
        active_set(root, aim, maxiter=100 * right.shape[1])[0]
        for root, aim in zip(roots.numpy(), y[..., 0].numpy(), strict=True)
    ]
    return torch.from_numpy(np.stack(found)).to(right)


_LEAST_CURVATURE = 1e-3  # of what neither pictures nor priors tell of


@torch.no_grad()
def laplace(
    minimum: Float[Tensor, "b q"],
    deviations: Float[Tensor, "b m"],
    hessian: Float[Tensor, "b q q"],
    weights: Float[Tensor, "#b m"],
    prior: Prior,
) -> Float[Tensor, " b"]:
    """log of the integral of ``exp(-f)``, with f as in :mod:`skylight.inverse._gauss_newton`::

        -f(x) + q / 2 log(2 pi) - 1/2 log det H(x)

    at minima x of f, of deviations r that count w, with H its :func:`hessian_at`.

    Each unknown costs the part of its prior that the pictures rule out (MacKay 1992, "Bayesian
    interpolation", Neural Computation 4(3)). Of 30 unknowns and deviations of a half to ten
    hundredths of the mean it is within 7 nats of the integral.
    """
    rows = torch.arange(len(minimum), device=minimum.device)
    values = torch.linalg.eigvalsh(hessian).clamp(min=_LEAST_CURVATURE)
    volume = 0.5 * (math.log(2 * math.pi) - values.log()).sum(1)
    data = (charbonnier(deviations) * _exact(deviations, weights)).sum(1)
    return volume - data.double() - prior(minimum, rows).double()


@torch.no_grad()
def hessian_at(
    deviations: Float[Tensor, "b m"],
    jacobian: Float[Tensor, "b m q"],
    weights: Float[Tensor, "#b m"],
    prior: Float[Tensor, "b q q"],
) -> Float[Tensor, "b q q"]:
    """``J^T diag(w / m) J + Q``, w / m the :func:`curvatures` and Q the prior's Hessian."""
    curved = jacobian * curvatures(deviations, weights)[:, :, None]
    return prior.double() + torch.einsum("bmp,bmq->bpq", jacobian, curved).double()


@torch.no_grad()
def spreads_at(
    hessian: Float[Tensor, "b q q"], slopes: Float[Tensor, "b k q"]
) -> Float[Tensor, "b k"]:
    """Standard deviations ``(g^T H^-1 g)^(1/2)`` of k quantities of slopes g.

    Under the normal density of curvature H about the minimum, to first order.
    """
    values, vectors = torch.linalg.eigh(hessian)
    along = slopes.double() @ vectors
    return (along.square() / values.clamp(min=_LEAST_CURVATURE)[:, None]).sum(2).sqrt()


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
