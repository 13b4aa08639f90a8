"""The best points of an objective, and what they mean in the photographs' units."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.inverse.objective.descent import Points
from skylight.inverse.objective.evidence import log_evidence
from skylight.inverse.objective.light_objective import LightObjective, Unpacked
from skylight.inverse.objective.lit_faces import Level, LitFaces
from skylight.inverse.result import FaceLight, Status, residual


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
