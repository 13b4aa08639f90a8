"""From the best points of an objective to an estimate in the photographs' units.

:class:`Solutions` holds the best point of each problem and how likely the faces are under its light
model (:func:`log_evidence`, by which models compete); :func:`face_lights` is what the light does to
each face; :func:`estimate_of` puts the answer of any solver together, with its posterior.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.imaging._edits import Edit
from skylight.inverse._descent import Iterates, deviations_apart, jacobian
from skylight.inverse._faces import Level, LitFaces, Unpacked
from skylight.inverse._gauss_newton import charbonnier
from skylight.inverse._least_squares import hessian_at, laplace, spreads_at
from skylight.inverse._objective import LightObjective
from skylight.inverse._posterior import SunEvidence, sun_posterior
from skylight.inverse._result import (
    TRUSTED,
    Estimate,
    FaceLight,
    Lamp,
    Status,
    advice,
    misplaced_shading,
    residual,
)
from skylight.inverse._scale import DAYLIGHT_HUE
from skylight.inverse._scan import SunScan
from skylight.inverse._sun_prior import SunPrior
from skylight.inverse._verdict import Spreads, spread_of
from skylight.models._base import Prior
from skylight.models._ground import below_and_above
from skylight.sphere._envmap import EnvironmentMap, luminance


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
    return _Minimum.at(objective, free, problem).log_evidence()


@dataclass(frozen=True, kw_only=True)
class _Minimum:
    """Minima with their deviations, of each face relative to how far it is off, and the curvature.

    Of concave costs (backgrounds, faces of unknown noise) that is the curvature of the quadratic
    that lies above them, of a background up to a half too large: spreads that one makes small are
    so by up to a fifth.
    """

    objective: LightObjective
    free: Float[Tensor, "b q"]
    problem: Int[Tensor, " b"] | None
    deviations: Float[Tensor, "b m"]
    weights: Float[Tensor, "b m"]
    more: Float[Tensor, " b"]  # what backgrounds cost, and faces that deviate by more
    hessian: Float[Tensor, "b q q"]

    @staticmethod
    def at(
        objective: LightObjective, free: Float[Tensor, "b q"], problem: Int[Tensor, " b"] | None
    ) -> "_Minimum":
        off, behind = deviations_apart(objective, free, problem)
        change = jacobian(objective, free, problem)
        scales = objective.scale_of_noise(off, problem)
        scale, seen = objective.of_pixels(scales, problem), off.shape[1]
        weights = objective.deviation_weights(off, problem) * scale
        # what concave costs are above their tangents
        more = scales.log().sum(1) * objective.weights.independent
        _, of_priors = objective.prior_shape(free, problem, clock=False)
        hessian = hessian_at(off / scale, change[:, :seen] / scale[:, :, None], weights, of_priors)
        if behind:
            rows, along = torch.cat(list(behind.values()), 1), change[:, seen:]
            counted = objective.background_weights(behind) / charbonnier(rows)
            hessian = hessian + (along.mT @ (along * counted[:, :, None])).double()
            more = more + objective.background_nll(behind)
        return _Minimum(
            objective=objective,
            free=free,
            problem=problem,
            deviations=off / scale,
            more=more,
            weights=weights,
            hessian=hessian,
        )

    def log_evidence(self) -> Float[Tensor, " b"]:
        prior = _prior(self.objective, self.problem)
        turn = 0.0 if self.objective.model.azimuth_index is None else math.log(2 * math.pi)
        nats = laplace(self.free, self.deviations, self.hessian, self.weights, prior)
        return nats - self.more.double() - turn

    def spreads(self) -> list[Spreads]:
        """Of each minimum's map, in the units of its first photograph."""
        with torch.enable_grad():
            leaf = self.free.detach().requires_grad_(True)
            told = _level_and_tints(self.objective, leaf)
            slopes = [
                torch.autograd.grad(column.sum(), leaf, retain_graph=True)[0]
                for column in told.unbind(1)
            ]
        level, red, blue = spreads_at(self.hessian, torch.stack(slopes, 1)).unbind(1)
        tint = torch.maximum(red, blue)
        return [
            Spreads(level=a, tint=b) for a, b in zip(level.tolist(), tint.tolist(), strict=True)
        ]


def _prior(
    objective: LightObjective, problem: Int[Tensor, " b"] | None
) -> Callable[[Tensor, Tensor], Tensor]:
    """All priors but that of clock and place."""

    def prior(x: Tensor, rows: Tensor) -> Tensor:
        mine = None if problem is None else problem[rows]
        return objective.prior(x, mine, without=["sun_prior"])

    return prior


def _level_and_tints(objective: LightObjective, free: Float[Tensor, "b q"]) -> Float[Tensor, "b 3"]:
    """Log of the map's mean luminance, and of its mean red and blue over green."""
    parts = objective.unpack(free)
    light, ground = objective.radiance(parts)
    grid = objective.model.grid
    whole = torch.einsum("n,bnc->bc", grid.solid_angles.to(light), light)
    if not grid.is_sphere:
        whole = whole + 2 * math.pi * ground
    whole = (parts.exposure[:, :1] * whole).clamp(min=1e-12)
    red, green, blue = whole.log().unbind(1)
    return torch.stack([luminance(whole).log(), red - green, blue - green], 1)


@dataclass(frozen=True, kw_only=True)
class Search:
    """How the search for a light ended: the fields of that name of an ``Estimate``."""

    terms: dict[str, float]
    status: Status
    stats: dict[str, float | int]
    log_evidence: float | None = None
    notes: tuple[str, ...] = ()
    spreads: Spreads | None = None


@dataclass(frozen=True, kw_only=True)
class Solutions:
    """The best iterate of each of p problems, and what it means."""

    objective: LightObjective
    parts: Unpacked
    white_balance: Float[Tensor, "p k 3"]
    edits: Float[Tensor, "p k 2"]
    albedos: list[Float[Tensor, "p _ 3"]]
    shadings: list[Float[Tensor, "p _ 3"]]
    terms: dict[str, Float[Tensor, " p"]]
    status: list[Status]
    stats: list[dict[str, float | int]]
    spreads: list[Spreads]
    log_evidence: Float[Tensor, " p"] | None
    trust: dict[int, Float[Tensor, " p"]]

    @staticmethod
    @torch.no_grad()
    def of(
        objective: LightObjective, points: Sequence[Iterates], *, evidence: bool = False
    ) -> "Solutions":
        """With the :func:`log_evidence` where that is asked for."""
        best = [int(one.scores.argmin()) for one in points]
        free = torch.stack([one.free[i] for one, i in zip(points, best, strict=True)])
        problem = torch.arange(len(points)).to(free.device)
        parts = objective.unpack(free)
        light = objective.radiance(parts)
        minimum = _Minimum.at(objective, free, problem)
        status: list[Status] = []
        for one, i in zip(points, best, strict=True):
            if bool(one.converged[i]):
                status.append("converged")
            else:
                status.append(
                    "recovered from a non-finite step" if one.nonfinite else "iteration limit"
                )
        return Solutions(
            objective=objective,
            parts=parts,
            white_balance=objective.white_balance(parts),
            edits=objective.edits(parts),
            albedos=[objective.albedo(parts, k, problem) for k in range(len(objective.faces))],
            shadings=objective.shading(parts, problem, light),
            terms=objective.terms(free, problem),
            status=status,
            stats=[{"evaluations": one.evaluations, "nonfinite": one.nonfinite} for one in points],
            spreads=minimum.spreads(),
            log_evidence=minimum.log_evidence() if evidence else None,
            trust={
                photo: objective.backgrounds[photo].trust(rows)
                for photo, rows in objective.behind(parts, light).items()
            },
        )

    def search(self, p: int, scan: SunScan) -> Search:
        """How that of problem ``p`` ended, which began with the scan."""
        return Search(
            terms={name: float(values[p]) for name, values in self.terms.items()},
            status=self.status[p],
            stats={
                **self.stats[p],
                "scan_residual": float(scan.residuals.min()),
                "sun_strength": float(scan.strengths[0]),
                **{f"background_trust_{k}": float(each[p]) for k, each in self.trust.items()},
            },
            log_evidence=None if self.log_evidence is None else float(self.log_evidence[p]),
            notes=tuple(
                f"the background{f' of photograph {k + 1}' if len(self.trust) > 1 else ''} was "
                "hardly used: it does not look like the light on the face (a backdrop, a screen, "
                "other lamps?)"
                for k, each in self.trust.items()
                if float(each[p]) < TRUSTED
            ),
            spreads=self.spreads[p],
        )


def face_lights(
    solutions: Solutions, p: int, faces: LitFaces, level: Level
) -> tuple[FaceLight, ...]:
    """What the light of problem ``p`` does to its faces, in their units and on the CPU."""
    parts, scales = solutions.parts, faces.scales()
    lights = []
    for k, (face, term) in enumerate(zip(faces, faces.terms(level), strict=True)):
        # others may have more pixels
        shading = term.seen(solutions.shadings[k][p, : term.target.shape[1]])
        clipped = None if term.clipped is None else term.clipped[0]
        seen = face.scanned.coarser(level.pixels) if level.pixels else face.scanned
        turns = None if term.normals is None else solutions.objective.turns(parts, k)
        saturation, contrast = solutions.edits[p, face.photo].tolist()
        lights.append(
            FaceLight(
                photo=face.photo,
                exposure=float(parts.exposure[p, face.photo]) * scales[face.photo],
                white_balance=solutions.white_balance[p, face.photo].cpu(),
                edit=Edit(saturation=saturation, contrast=contrast, pivot=scales[face.photo]),
                albedo=parts.albedo[p, k].cpu(),
                pixel_albedo=solutions.albedos[k][p, : len(shading)].cpu(),
                specular_scale=float(parts.specular_scale[p, k]),
                rendered=(shading * scales[face.photo]).cpu(),
                residual=residual(shading, term.target[0], clipped),
                misplaced=misplaced_shading(shading.cpu(), seen.to(torch.device("cpu"))),
                turns=None if turns is None else turns[p].cpu(),
            )
        )
    return tuple(lights)


def estimate_of(
    light: str,
    params: Float[Tensor, " p"],
    environment: EnvironmentMap,
    faces: tuple[FaceLight, ...],
    search: Search,
    evidence: SunEvidence,
    *,
    sun: Float[Tensor, "3"] | None,
    albedo_prior: Prior,
    reflects: bool,
    sun_prior: SunPrior | None = None,
    ground_albedo: Float[Tensor, "3"] | None = None,
    lamps: tuple[Lamp, ...] | None = None,
    seen: bool | None = None,
    kinds: Mapping[str, float] | None = None,
) -> Estimate:
    """The answer of a solver, with its posterior and advice, on the CPU.

    ``sun`` is the optimised direction of the sun or main lamp, None of light without one.
    ``albedo_prior`` and ``reflects``, whether a specular scale was estimated, say how sure exposure
    and albedo are; ``ground_albedo`` is None where the map's lower half is free, and is then
    measured there. ``lamps`` are those of a model that has some, None of skies. ``seen``: there is
    a main light; by default where the face tells of one.
    """
    posterior = sun_posterior(
        evidence,
        sun,
        seen=seen,
        exposure=faces[0].exposure,
        albedo=faces[0].albedo,
        specular_scale=faces[0].specular_scale if reflects else None,
        albedo_prior=albedo_prior,
        sun_prior=sun_prior,
    )
    return Estimate(
        light=light,
        environment=environment,
        params=params,
        ground_albedo=measured_ground(environment) if ground_albedo is None else ground_albedo,
        sun_direction=environment.brightest_direction() if sun is None else sun,
        posterior=posterior,
        spreads=search.spreads
        or Spreads(level=spread_of(posterior.exposure_interval), tint=DAYLIGHT_HUE),
        faces=faces,
        terms=search.terms,
        status=search.status,
        advice=(*advice(faces), *search.notes),
        stats=search.stats,
        lamps=lamps or (),
        kinds=dict(kinds or {}),
        log_evidence=search.log_evidence,
    )


def measured_ground(environment: EnvironmentMap) -> Float[Tensor, "3"]:
    """Mean radiance of the lower half over that of a white ground below the upper half."""
    below, white = below_and_above(environment.layout[0]).float() @ environment.flat
    return (below / white.clamp(min=1e-12)).clamp(0, 1)
