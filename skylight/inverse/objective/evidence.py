"""How likely faces are under a light model, by which models compete."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.inverse.charbonnier import charbonnier
from skylight.inverse.gauss_newton import prior_shape
from skylight.inverse.objective.light_objective import LightObjective
from skylight.inverse.objective.linearised import deviations, jacobian

_LEAST_CURVATURE = 1e-3  # of what neither faces nor priors tell of


@torch.no_grad()
def log_evidence(
    objective: LightObjective,
    free: Float[Tensor, "b q"],
    problem: Int[Tensor, " b"] | None = None,
) -> Float[Tensor, " b"]:
    """Laplace's approximation of log p(faces | light model), at minima ``free`` of the objective::

        -f(x) + q / 2 log(2 pi) - 1/2 log det H(x),    H = J^T diag(w / m) J + Q,

    with J the derivatives of the deviations r, w what each counts, m their mean ``|r|`` and Q the
    priors' Hessian. ``w |r|`` has a kink at 0: where r has Laplace's density about it, the mean of
    such terms has the curvature w / m; bounds that are kept have none. Up to what is the same for
    all light models, on the same pixels with the same weights (constants of the pixels' density,
    exposure's flat prior) and to half a nat, by which the ground's albedo is a density of its log.
    What clock and place tell of the sun is left out: lamps have nothing to set against it.

    Each unknown of a light costs the part of its prior that the faces rule out (MacKay 1992,
    "Bayesian interpolation", Neural Computation 4(3)). Of 30 unknowns and deviations of a half to
    ten hundredths of a face's mean it is within 7 nats of the integral.
    """
    weights = objective.deviation_weights(problem)
    deviation = deviations(objective, free, problem)
    each, weights = charbonnier(deviation), weights * (deviation != 0)  # 0: bounds that are kept
    mean = (each * weights).sum(1, keepdim=True) / weights.sum(1, keepdim=True)
    change = jacobian(objective, free, problem)
    curved = change * (weights / mean)[:, :, None]
    rows = torch.arange(len(free), device=free.device)

    def prior(x: Tensor, rows: Tensor) -> Tensor:
        priors = objective.priors(x, None if problem is None else problem[rows])
        return torch.stack([nll for name, nll in priors.items() if name != "sun_prior"]).sum(0)

    _, hessian = prior_shape(prior, free, rows)
    hessian = hessian.double() + torch.einsum("bmp,bmq->bpq", change, curved).double()
    values = torch.linalg.eigvalsh(hessian).clamp(min=_LEAST_CURVATURE)
    volume = 0.5 * (math.log(2 * math.pi) - values.log()).sum(1)
    turn = 0.0 if objective.model.azimuth_index is None else math.log(2 * math.pi)  # any azimuth
    return volume - (each * weights).sum(1).double() - prior(free, rows).double() - turn
