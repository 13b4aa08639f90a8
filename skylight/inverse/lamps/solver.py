"""Eq. 5.8 for lamps in ambient light, as many lamps as the picture tells of."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.inverse.lamps.number import MAP_ROWS, Fitted, as_many_as_pay, in_pictures_units
from skylight.inverse.lamps.pursuit import Pursuit
from skylight.inverse.objective.answer import Ends, face_lights
from skylight.inverse.objective.descent import Points, Round, descend
from skylight.inverse.objective.evidence import log_evidence
from skylight.inverse.objective.light_objective import LightObjective
from skylight.inverse.objective.lit_faces import Level, LitFaces
from skylight.inverse.objective.starts import choose_starts
from skylight.inverse.objective.weights import ObjectiveWeights
from skylight.inverse.posterior import SunEvidence, face_evidence, sun_evidence, sun_posterior
from skylight.inverse.result import UNEXPLAINED, Estimate, advice
from skylight.inverse.scan import SunScan, scan_faces
from skylight.models.lamps import LampsLight, LampsPrior
from skylight.models.prior import GaussianMixture
from skylight.work.progress import Progress


@dataclass(frozen=True, kw_only=True)
class LampsOptions:
    """Effort of the optimisation, as :class:`~skylight.inverse.sky.solver.SolverOptions`.

    ``coarse`` are the rounds with no lamp to three, each from the best ``sets`` of so many, one
    lamp from ``scan_candidates`` directions too; ``fine`` those with the number of lamps that
    was chosen.
    """

    scan_candidates: int = 6
    sets: int = 6
    coarse: tuple[Round, ...] = (
        Round(level=Level(2), starts=10, iterations=6, even_skin=True, steps="gauss-newton"),
        Round(level=Level(1), starts=3, iterations=8, even_skin=True, steps="gauss-newton"),
    )
    fine: tuple[Round, ...] = (
        Round(level=Level(0), starts=1, iterations=8, steps="gauss-newton"),
        Round(level=Level(0), starts=1, iterations=5, steps="gauss-newton"),
    )
    tolerance: float = 1e-4
    weights: ObjectiveWeights = ObjectiveWeights()

    @property
    def levels(self) -> list[Level]:
        return sorted({one.level for one in (*self.coarse, *self.fine)})


@dataclass(frozen=True, kw_only=True, eq=False)
class LampsSolver:
    """The priors of skin, and the effort to spend; on the device of ``albedo_modes``."""

    albedo_prior: GaussianMixture
    albedo_modes: Float[Tensor, "k 3"]
    options: LampsOptions

    def solve(self, faces: LitFaces, progress: Progress | None = None) -> Estimate:
        """Ambient light alone, then one lamp more as long as that is likelier.

        Each number of lamps starts from the sets that explain the face best
        (:class:`~skylight.inverse.lamps.pursuit.Pursuit`), one lamp also from the directions of the
        scan over the sphere. Numbers compete on a coarse level by
        :func:`~skylight.inverse.objective.evidence.log_evidence`: one more is to bring
        :data:`~skylight.inverse.lamps.number.LEAST_GAIN`.
        """
        options, observed = self.options, [face.scanned for face in faces]
        every = scan_faces(observed, sphere=True)
        scan = SunScan.of(every, candidates=options.scan_candidates)
        evidence = sun_evidence(face_evidence(observed, every, sphere=True))
        pursuit = Pursuit(observed)

        def fitted(count: int) -> Fitted[Points]:
            objective = self._objective(faces, count, options.coarse[0])
            assert isinstance(objective.model, LampsLight)
            towards = pursuit.starts(objective.model, options.sets)
            if count == 1:
                scanned = objective.model.starts_towards(scan.candidates)
                towards = torch.cat([towards, scanned.to(towards)])
            points = Points.starting(*choose_starts(objective, towards, self.albedo_modes))
            objective, points = self._descend(faces, count, points, options.coarse)
            end = points.free[points.scores.argmin(), None]
            return Fitted(
                count=count, point=points, log_evidence=float(log_evidence(objective, end))
            )

        best = as_many_as_pay(fitted)
        objective, points = self._descend(faces, best.count, best.point, options.fine, progress)
        ends = Ends.of(objective, [points], evidence=True)
        return _estimate(ends, faces, options.fine[-1].level, scan, evidence)

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


def _estimate(
    ends: Ends, faces: LitFaces, level: Level, scan: SunScan, evidence: SunEvidence
) -> Estimate:
    """The answer, in its photographs' units and on the CPU."""
    model = ends.objective.model
    assert isinstance(model, LampsLight)
    assert ends.log_evidence is not None
    params = ends.parts.light[0].cpu()
    lights = face_lights(ends, 0, faces, level)
    exposure = lights[0].exposure
    environment, lamps = in_pictures_units(model.count, params, exposure)
    ground = environment.radiance[MAP_ROWS // 2 :].reshape(-1, 3).mean(0)
    down = environment.upper().irradiance(torch.tensor([0.0, 1.0, 0.0])) / torch.pi
    main = lamps[0].direction if lamps else None
    posterior = sun_posterior(
        evidence,
        main,
        seen=bool(lamps),
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
        sun_direction=environment.brightest_direction() if main is None else main,
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
