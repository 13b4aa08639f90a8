"""How likely faces are under a light model, by which models compete."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.inverse.laplace import laplace
from skylight.inverse.objective.light_objective import LightObjective
from skylight.inverse.objective.linearised import deviations, jacobian


@torch.no_grad()
def log_evidence(
    objective: LightObjective,
    free: Float[Tensor, "b q"],
    problem: Int[Tensor, " b"] | None = None,
) -> Float[Tensor, " b"]:
    """:func:`~skylight.inverse.laplace.laplace` of log p(faces | light model), at minima ``free``.

    Up to what is the same for all light models, on the same pixels with the same weights (constants
    of the pixels' density, exposure's flat prior) and to half a nat, by which the ground's albedo
    is a density of its log. What clock and place tell of the sun is left out: lamps have nothing
    to set against it.
    """

    def prior(x: Tensor, rows: Tensor) -> Tensor:
        priors = objective.priors(x, None if problem is None else problem[rows])
        return torch.stack([nll for name, nll in priors.items() if name != "sun_prior"]).sum(0)

    turn = 0.0 if objective.model.azimuth_index is None else math.log(2 * math.pi)  # any azimuth
    nats = laplace(
        free,
        deviations(objective, free, problem),
        jacobian(objective, free, problem),
        objective.deviation_weights(problem),
        prior,
    )
    return nats - turn
