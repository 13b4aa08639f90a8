"""The best points of an objective, and what they mean in the photographs' units.

How likely faces are under a light model, by which models compete.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.inverse._descent import Points, deviations, jacobian
from skylight.inverse._faces import Level, LitFaces
from skylight.inverse._least_squares import laplace
from skylight.inverse._objective import LightObjective, Unpacked
from skylight.inverse._result import FaceLight, Status, residual


@torch.no_grad()
def log_evidence(
    objective: LightObjective,
    free: Float[Tensor, "b q"],
    problem: Int[Tensor, " b"] | None = None,
) -> Float[Tensor, " b"]:
    """:func:`laplace` of log p(faces | light model), at minima ``free``.

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


@dataclass(frozen=True, kw_only=True)
class Ends:
    """The best point of each of p problems, and what it means."""

    objective: LightObjective
    parts: Unpacked
    white_balance: Float[Tensor, "p k 3"]
    albedos: list[Float[Tensor, "p _ 3"]]
    shadings: list[Float[Tensor, "p _ 3"]]
    terms: dict[str, Float[Tensor, " p"]]
    status: list[Status]
    stats: list[dict[str, float | int]]
    log_evidence: Float[Tensor, " p"] | None

    @staticmethod
    @torch.no_grad()
    def of(
        objective: LightObjective, points: Sequence[Points], *, evidence: bool = False
    ) -> "Ends":
        """With the :func:`log_evidence` where that is asked for."""
        best = [int(one.scores.argmin()) for one in points]
        free = torch.stack([one.free[i] for one, i in zip(points, best, strict=True)])
        problem = torch.arange(len(points)).to(free.device)
        parts = objective.unpack(free)
        status: list[Status] = []
        for one, i in zip(points, best, strict=True):
            if bool(one.converged[i]):
                status.append("converged")
            else:
                status.append(
                    "recovered from a non-finite step" if one.nonfinite else "iteration limit"
                )
        return Ends(
            objective=objective,
            parts=parts,
            white_balance=objective.white_balance(parts),
            albedos=[objective.albedo(parts, k, problem) for k in range(len(objective.faces))],
            shadings=objective.shading(parts, problem),
            terms=objective.terms(free, problem),
            status=status,
            stats=[{"evaluations": one.evaluations, "nonfinite": one.nonfinite} for one in points],
            log_evidence=log_evidence(objective, free, problem) if evidence else None,
        )


def face_lights(ends: Ends, p: int, faces: LitFaces, level: Level) -> tuple[FaceLight, ...]:
    """What the light of problem ``p`` does to its faces, in their units and on the CPU."""
    parts, scales = ends.parts, faces.scales()
    lights = []
    for k, (face, term) in enumerate(zip(faces, faces.terms(level), strict=True)):
        # others may have more pixels
        shading = term.seen(ends.shadings[k][p, : term.target.shape[1]])
        clipped = None if term.clipped is None else term.clipped[0]
        turns = None if term.normals is None else ends.objective.turns(parts, k)
        lights.append(
            FaceLight(
                photo=face.photo,
                exposure=float(parts.exposure[p, face.photo]) * scales[face.photo],
                white_balance=ends.white_balance[p, face.photo].cpu(),
                albedo=parts.albedo[p, k].cpu(),
                pixel_albedo=ends.albedos[k][p, : len(shading)].cpu(),
                gloss=float(parts.gloss[p, k]),
                rendered=(shading * scales[face.photo]).cpu(),
                residual=residual(shading, term.target[0], clipped),
                turns=None if turns is None else turns[p].cpu(),
            )
        )
    return tuple(lights)
