"""Robust least squares with a prior: Gauss-Newton steps, damped by Levenberg and Marquardt.

Minimises, for several starts at once, ::

    f(x) = sum_i w_i rho(r_i(x)) + q(x),    rho(r) = sqrt(r^2 + 1e-6).

rho is replaced by the quadratic of the same value and slope that lies above it (half quadratic:
Geman & Reynolds 1992), of curvature 1 / rho(r), so a step has the Hessian ::

    J^T diag(w / rho(r)) J + Q,

with Q that of q, its negative eigenvalues cut off, plus lambda times its own diagonal (Marquardt
1963). Descents along gradients alone take hundreds of steps where a residual is nearly linear and
its unknowns stand for one another, as ambient light and wide lamps do.

With ``broyden``, J is that of the start; each accepted step dx, of change dr, corrects it by the
least that explains the step (Broyden 1965), ::

    J <- J + (dr - J dx) dx^T / |dx|^2,

and J is computed anew once a step with a corrected one is rejected: derivatives of a decoder take
several times as long as the rest of a step. Small steps then end the descent, though the slope of
a corrected J is not exact. Else J is computed after every accepted step.
"""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.inverse._lbfgs import Minimum
from skylight.models._prior import convex_shape

CHARBONNIER_EPSILON = 1e-6


def charbonnier(x: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """``sqrt(x^2 + 1e-6)``: smooth, convex, close to ``|x|``."""
    return torch.sqrt(x * x + CHARBONNIER_EPSILON)


# Of points (b,p), and of which starts they are (b,)
Residuals = Callable[[Tensor, Tensor], Tensor]  # (b,m)
Jacobian = Callable[[Tensor, Tensor], Tensor]  # (b,m,p)
Prior = Callable[[Tensor, Tensor], Tensor]  # (b,)
Shape = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]  # (b,p) and (b,p,p)
FIRST_DAMPING, LESS, MORE = 1e-2, 0.3, 5.0


@torch.no_grad()
def minimise_robust(
    residuals: Residuals,
    jacobian: Jacobian,
    weights: Float[Tensor, "#b m"],
    prior: Prior,
    x0: Float[Tensor, "b p"],
    *,
    iterations: int,
    tolerance: float = 1e-5,
    broyden: bool = False,
    shape: Shape | None = None,
) -> Minimum:
    """The best point from each start; never worse than the start.

    ``tolerance`` is relative to the loss: a start is finished once an accepted step lowers it by
    less. Steps to where the loss is not finite are rejected; a start where it is not has an
    infinite loss. The Jacobian of every start is held. ``shape`` is the prior's slope and a Hessian
    that has no negative eigenvalues, by default by differences.
    """
    x = x0.clone()
    count = len(x)
    every = torch.arange(count, device=x.device)
    weights = weights.expand(count, -1)

    def loss_of(points: Tensor, rows: Tensor, r: Tensor) -> Tensor:
        return (charbonnier(r) * weights[rows]).sum(1) + prior(points, rows)

    r = residuals(x, every)
    loss = loss_of(x, every, r)
    loss = torch.where(loss.isfinite(), loss, torch.inf)
    change = x.new_zeros(count, r.shape[1], x.shape[1])
    slopes = x.new_zeros(x.shape, dtype=torch.float64)
    hessians = x.new_zeros((*x.shape, x.shape[1]), dtype=torch.float64)
    stale = torch.ones(count, dtype=torch.bool, device=x.device)  # change is of no use
    moved = stale.clone()  # since slope and Hessian were computed
    corrected = ~stale  # change is not the Jacobian itself
    moving = stale.clone()
    damping = x.new_full((count,), FIRST_DAMPING)
    used, rejected = torch.zeros_like(every), torch.zeros_like(every)
    for _ in range(iterations):
        # the one answer that is waited for: what is computed, and of which starts
        flags = torch.stack([moving, moving & stale, moving & moved]).cpu()
        which, outdated, elsewhere = (flag.nonzero()[:, 0].to(x.device) for flag in flags)
        if len(which) == 0:
            break
        if len(outdated):
            change[outdated] = jacobian(x[outdated], outdated)
            stale[outdated] = corrected[outdated] = False
        if len(elsewhere):
            new = elsewhere
            slope, hessian = shape(x[new], new) if shape else convex_shape(prior, x[new], new)
            along, off = change[new], r[new]
            curved = along * (weights[new] / charbonnier(off))[:, :, None]
            slope = slope.double() + (off[:, None] @ curved)[:, 0].double()
            hessian = hessian.double() + (along.mT @ curved).double()
            # a start where nothing is finite stays where it is: its step is 0
            usable = slope.isfinite().all(1) & hessian.isfinite().all(2).all(1)
            slopes[new] = torch.where(usable[:, None], slope, 0.0)
            hessians[new] = torch.where(usable[:, None, None], hessian, 0.0)
            moved[new], moving[new] = False, usable
        at, slope, hessian, tries = x[which], slopes[which], hessians[which], moving[which]
        diagonal = hessian.diagonal(dim1=1, dim2=2).clamp(min=1e-6)
        damped = hessian + torch.diag_embed(damping[which, None].double() * diagonal)
        step = -torch.linalg.solve_ex(damped, slope[..., None])[0][..., 0].to(x)
        trial = at + step
        tried = residuals(trial, which)
        value = loss_of(trial, which, tried)
        better = tries & (value < loss[which])
        used[which] += tries.long()
        rejected[which] += (tries & ~value.isfinite()).long()
        settled = better & (loss[which] - value <= tolerance * loss[which].abs())
        damping[which] *= torch.where(better, LESS, MORE)
        if broyden:
            missed = tried - r[which] - (change[which] @ step[:, :, None])[:, :, 0]
            missed = torch.where(better[:, None], missed, 0.0)
            along = step / step.square().sum(1, keepdim=True).clamp(min=1e-30)
            along = torch.where(better[:, None], along, 0.0)
            change.index_add_(0, which, missed[:, :, None] * along[:, None])
            again = ~better & corrected[which]
            stale[which] |= again
            moved[which] = better | again
            corrected[which] |= better
        else:
            stale[which] |= better
            moved[which] = better
        x[which] = torch.where(better[:, None], trial, at)
        r[which] = torch.where(better[:, None], tried, r[which])
        loss[which] = torch.where(better, value, loss[which])
        moving[which] = tries & ~(settled | (damping[which] > 1e8))
    return Minimum(
        x=x,
        loss=loss,
        converged=~moving,
        iterations=used,
        evaluations=used,
        nonfinite=rejected,
    )
