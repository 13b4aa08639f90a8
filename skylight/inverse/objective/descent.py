"""Rounds of descent from many starts, of several problems as one batch."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight.inverse.gauss_newton import minimise_robust
from skylight.inverse.lbfgs import minimise
from skylight.inverse.objective.light_objective import LightObjective
from skylight.inverse.objective.linearised import deviations, jacobian
from skylight.inverse.objective.lit_faces import Level


@dataclass(frozen=True, kw_only=True)
class Round:
    """So many of the best ``starts``, minimised on a ``level`` of the pyramid.

    With ``even_skin`` each face has one albedo, whatever the weights say. ``steps`` of Gauss and
    Newton take as many derivatives of the light as that has parameters, those with Broyden's
    updates about as many in all, which serves near a minimum; those of L-BFGS cost little, for
    many starts.
    """

    level: Level
    starts: int
    iterations: int
    even_skin: bool = False
    steps: Literal["l-bfgs", "gauss-newton", "broyden"] = "l-bfgs"


@dataclass(frozen=True, kw_only=True)
class Points:
    """Points of one problem, where rounds start and end, and what led there."""

    free: Float[Tensor, "s q"]
    scores: Float[Tensor, " s"]
    converged: Bool[Tensor, " s"]
    evaluations: int = 0
    nonfinite: int = 0

    @staticmethod
    def starting(free: Float[Tensor, "s q"], scores: Float[Tensor, " s"]) -> "Points":
        """Where nothing has been minimised yet."""
        return Points(free=free, scores=scores, converged=torch.zeros_like(scores) > 0)


def descend(
    objective: LightObjective, points: Sequence[Points], effort: Round, tolerance: float
) -> list[Points]:
    """The best of each problem's points, minimised as one batch."""
    best = [one.free[one.scores.argsort()[: effort.starts]] for one in points]
    starts = [objective.uneven(free) for free in best]
    sizes = [len(start) for start in starts]
    problem = torch.cat([torch.full((n,), p) for p, n in enumerate(sizes)]).to(starts[0].device)
    if effort.steps != "l-bfgs":
        result = minimise_robust(
            lambda x, rows: deviations(objective, x, problem[rows]),
            lambda x, rows: jacobian(objective, x, problem[rows]),
            objective.deviation_weights(problem),
            lambda x, rows: objective.prior(x, problem[rows]),
            torch.cat(starts),
            iterations=effort.iterations,
            tolerance=tolerance,
            broyden=effort.steps == "broyden",
        )
    else:
        result = minimise(
            lambda x, rows: objective(x, problem[rows]),
            torch.cat(starts),
            iterations=effort.iterations,
            tolerance=tolerance,
        )
    # in the tone to answer with, so that hue and light settle to it
    free = objective.at_bayes_scale(result.x)
    with torch.no_grad():
        scores = objective(free, problem)
    ends = zip(
        points,
        free.split(sizes),
        scores.split(sizes),
        result.converged.split(sizes),
        result.evaluations.split(sizes),
        result.nonfinite.split(sizes),
        strict=True,
    )
    return [
        Points(
            free=free,
            scores=scores,
            converged=converged,
            evaluations=before.evaluations + int(evaluations.sum()),
            nonfinite=before.nonfinite + int(nonfinite.sum()),
        )
        for before, free, scores, converged, evaluations, nonfinite in ends
    ]
