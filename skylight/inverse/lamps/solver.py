"""Eq. 5.8 for lamps in ambient light, as many lamps as the picture tells of."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.inverse.objective.answer import Ends, face_lights
from skylight.inverse.objective.descent import Points, Round, descend
from skylight.inverse.objective.evidence import log_evidence
from skylight.inverse.objective.light_objective import LightObjective
from skylight.inverse.objective.lit_faces import LitFaces
from skylight.inverse.objective.starts import choose_starts
from skylight.inverse.objective.weights import ObjectiveWeights
from skylight.inverse.posterior import SunEvidence, face_evidence, sun_evidence, sun_posterior
from skylight.inverse.result import UNEXPLAINED, Estimate, Lamp, advice
from skylight.inverse.scan import SunScan, best_apart, scan_faces
from skylight.models.lamps import AMBIENT_PARAMETERS, LAMP_PARAMETERS, LampsLight, LampsPrior
from skylight.models.prior import GaussianMixture
from skylight.sphere.envmap import EnvironmentMap, luminance
from skylight.work.progress import Progress

MOST_LAMPS = 3
# Nats of evidence for a lamp more: what heads are wrong by is not as independent as the objective
# takes it to be, and lights the face as weak lamps would.
LEAST_GAIN = 10.0
MAP_ROWS = 64
APART_RAD = math.radians(20.0)  # candidates for one more lamp
GRAZING = 0.1
START_LOG_ENERGY = -0.5  # of one more lamp, in standard deviations


@dataclass(frozen=True, kw_only=True)
class LampsOptions:
    """Effort of the optimisation, as :class:`~skylight.inverse.sky.solver.SolverOptions`.

    ``first`` are the rounds with one lamp, from ``scan_candidates`` directions; ``further`` those
    with each lamp more, from ``candidates`` directions; ``last`` those with the number of lamps
    that was chosen.
    """

    scan_candidates: int = 10
    first: tuple[Round, ...] = (
        Round(level=3, starts=10, iterations=6, even_skin=True, steps="gauss-newton"),
        Round(level=2, starts=3, iterations=8, even_skin=True, steps="gauss-newton"),
    )
    candidates: int = 4
    further: tuple[Round, ...] = (
        Round(level=2, starts=4, iterations=10, even_skin=True, steps="gauss-newton"),
    )
    last: tuple[Round, ...] = (
        Round(level=1, starts=1, iterations=8, steps="gauss-newton"),
        Round(level=0, starts=1, iterations=5, steps="gauss-newton"),
    )
    tolerance: float = 1e-4
    weights: ObjectiveWeights = ObjectiveWeights()

    @property
    def levels(self) -> list[int]:
        return sorted({one.level for one in (*self.first, *self.further, *self.last)})


@dataclass(frozen=True, kw_only=True, eq=False)
class LampsSolver:
    """The priors of skin, and the effort to spend; on the device of ``albedo_modes``."""

    albedo_prior: GaussianMixture
    albedo_modes: Float[Tensor, "k 3"]
    options: LampsOptions

    def solve(self, faces: LitFaces, progress: Progress | None = None) -> Estimate:
        """One lamp in ambient light, then one more as long as that is likelier.

        The first starts from the directions of the linear scan over the sphere; each further one
        from those where light would lower the weighted squared error most, by the gradient that
        the best light so far leaves. Numbers of lamps compete on a coarse level by
        :func:`~skylight.inverse.objective.evidence.log_evidence`: one more is to bring
        :data:`LEAST_GAIN`.
        """
        options, observed = self.options, [face.scanned for face in faces]
        every = scan_faces(observed, sphere=True)
        scan = SunScan.of(every, candidates=options.scan_candidates)
        evidence = sun_evidence(face_evidence(observed, every, sphere=True))
        objective = self._objective(faces, 1, options.first[0])
        points = Points.starting(*choose_starts(objective, scan.candidates, self.albedo_modes))
        objective, points = self._descend(faces, 1, points, options.first)
        best, count, evidence_of_count = points, 1, _evidence(objective, points)
        for more in range(2, MOST_LAMPS + 1):
            starts = _with_one_more(objective, points, options.candidates)
            objective = self._objective(faces, more, options.further[0])
            with torch.no_grad():
                points = Points.starting(starts, objective(starts))
            objective, points = self._descend(faces, more, points, options.further)
            now = _evidence(objective, points)
            if now < evidence_of_count + LEAST_GAIN:
                break
            best, count, evidence_of_count = points, more, now
        objective, best = self._descend(faces, count, best, options.last, progress)
        ends = Ends.of(objective, [best], evidence=True)
        return _estimate(ends, faces, options.last[-1].level, scan, evidence)

    def _descend(
        self,
        faces: LitFaces,
        count: int,
        points: Points,
        rounds: Sequence[Round],
        progress: Progress | None = None,
    ) -> tuple[LightObjective, Points]:
        """The last round's objective, and its points."""
        for number, effort in enumerate(rounds, start=1):
            objective = self._objective(faces, count, effort)
            (points,) = descend(objective, [points], effort, self.options.tolerance)
            if progress is not None:
                progress(number / len(rounds))
        return objective, points

    def _objective(self, faces: LitFaces, count: int, effort: Round) -> LightObjective:
        weights = self.options.weights
        return LightObjective(
            faces.terms(effort.level),
            LampsLight(count).to(self.albedo_modes.device),
            LampsPrior(count),
            self.albedo_prior,
            replace(weights, pigment_spread=0.0) if effort.even_skin else weights,
        )


def _evidence(objective: LightObjective, points: Points) -> float:
    return float(log_evidence(objective, points.free[points.scores.argmin(), None]))


@torch.no_grad()
def _with_one_more(
    objective: LightObjective, points: Points, candidates: int
) -> Float[Tensor, "s q"]:
    """The best point with a weak lamp more in each of the directions that it lacks most."""
    best = points.free[points.scores.argmin(), None]
    parts, model = objective.unpack(best), objective.model
    gain = torch.zeros(len(model.grid)).to(best)
    for face, shading in zip(objective.faces, objective.shading(parts), strict=True):
        missing = -luminance(face.deviation(shading)[0])
        # reweighted least squares, as the mean absolute deviation has it
        weight = face.share[0, :, 0] / (missing.abs() + objective.weights.noise)
        matrix = face.transport.folded[0, :, :-1]
        slope = matrix.T @ (weight * missing)
        energy = matrix.square().T @ weight
        # directions that graze the face explain its edge well, by light that would be very strong
        gain = gain + slope.clamp(min=0).square() / (energy + GRAZING * energy.max())
    directions = model.grid.directions
    chosen = best_apart(directions, -gain.cpu(), candidates, APART_RAD)
    lamp = torch.zeros(len(chosen), LAMP_PARAMETERS).to(best)
    lamp[:, :3] = directions[chosen].to(best)
    lamp[:, 3] = START_LOG_ENERGY
    light, rest = best.expand(len(chosen), -1).tensor_split([model.parameter_count], 1)
    even = light.clone()
    even[:, :AMBIENT_PARAMETERS] = 0  # ambient light that has stood for the missing lamp
    return torch.cat([even, lamp, rest], 1)


def _estimate(
    ends: Ends, faces: LitFaces, level: int, scan: SunScan, evidence: SunEvidence
) -> Estimate:
    """The answer, in its photographs' units and on the CPU."""
    model = ends.objective.model
    assert isinstance(model, LampsLight)
    assert ends.log_evidence is not None
    params = ends.parts.light[0].cpu()
    lights = face_lights(ends, 0, faces, level)
    exposure = lights[0].exposure
    with torch.no_grad():
        radiance = LampsLight(model.count, MAP_ROWS)(params) * exposure
        found = model.cpu().lamps(params)
    environment = EnvironmentMap(radiance=radiance.reshape(MAP_ROWS, 2 * MAP_ROWS, 3))
    received = 4 * math.pi * exposure * found.energies * LampsLight.facing(found.widths_rad)
    every = [
        Lamp(
            direction=found.directions[k].double(),
            irradiance=received[k] * found.colours[k],
            spread_rad=float(found.widths_rad[k]),
        )
        for k in range(model.count)
    ]
    lamps = tuple(sorted(every, key=lambda lamp: -float(luminance(lamp.irradiance))))
    ground = environment.radiance[MAP_ROWS // 2 :].reshape(-1, 3).mean(0)
    down = environment.upper().irradiance(torch.tensor([0.0, 1.0, 0.0])) / torch.pi
    posterior = sun_posterior(
        evidence,
        lamps[0].direction,
        explained=all(light.residual <= UNEXPLAINED for light in lights),
        exposure=exposure,
        albedo=lights[0].albedo,
        gloss=None if faces[0].scanned.gloss is None else lights[0].gloss,
        albedo_prior=ends.objective.tone_prior,
    )
    return Estimate(
        light=model.name,
        environment=environment,
        params=params,
        ground_albedo=(ground / down.clamp(min=1e-12)).clamp(0, 1),
        sun_direction=lamps[0].direction,
        posterior=posterior,
        faces=lights,
        terms={name: float(values[0]) for name, values in ends.terms.items()},
        status=ends.status[0],
        advice=advice(lights),
        stats={
            **ends.stats[0],
            "scan_residual": float(scan.residuals.min()),
            "sun_strength": float(scan.strengths[0]),
        },
        lamps=lamps,
        log_evidence=float(ends.log_evidence),
    )
