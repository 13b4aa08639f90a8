"""Observations under one sky -> that sky: Eq. 5.8 minimised from many starts, coarse to fine."""

from dataclasses import dataclass, replace
from statistics import fmean

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.inverse.lbfgs import minimise
from skylight.inverse.posterior import sun_evidence, sun_posterior
from skylight.inverse.result import UNEXPLAINED, Estimate, FaceLight, Status, advice, residual
from skylight.inverse.scan import SCAN_HEIGHT, scan_sun
from skylight.inverse.sky.objective import FaceTerm, ObjectiveWeights, SkyObjective
from skylight.inverse.sky.starts import choose_starts
from skylight.models.base import LightModel, Prior
from skylight.models.prior import GaussianMixture
from skylight.sphere.envmap import EnvironmentMap, luminance
from skylight.transport.observation import Observation
from skylight.work.progress import Progress


@dataclass(frozen=True, kw_only=True)
class Round:
    """So many of the best ``starts``, minimised on ``level`` (0 is the finest) of the pyramid."""

    level: int
    starts: int
    iterations: int


@dataclass(frozen=True, kw_only=True)
class SolverOptions:
    """Effort of the optimisation: directions taken from the scan, then rounds, coarse to fine.

    Many starts matter: from three, faces lit from behind ended in minima up to 50 nats above those
    that ten find.
    """

    scan_candidates: int = 10
    rounds: tuple[Round, ...] = (
        Round(level=3, starts=10, iterations=10),
        Round(level=3, starts=4, iterations=15),
        Round(level=2, starts=2, iterations=12),
        Round(level=1, starts=1, iterations=10),
        Round(level=0, starts=1, iterations=10),
    )
    tolerance: float = 1e-4
    weights: ObjectiveWeights = ObjectiveWeights()


@dataclass(frozen=True, kw_only=True)
class _SkyFace:
    """What a sky needs of an observation: the pyramid's levels, and what the scan reads.

    Both are scaled to a mean luminance of 1 from ``mean``, in the photograph's units.
    """

    photo: int
    pyramid: dict[int, FaceTerm]
    scanned: Observation
    mean: float


class SkyProblem:
    """Eq. 5.8 for all faces under one light: give it each face, then solve.

    The faces of one photograph share its exposure. Of an observation's transport only the
    sky's half is kept, folded with the ground: with the pyramid 0.7 times as much memory as
    the observation's own, 165 MB for a face of 3,700 pixels seen on 64 rows with gloss. Let go
    of each observation once it is added, and eight such faces fit in 2.5 GB.

    Everything is computed on the device of ``albedo_modes``, where ``model`` and the priors have
    to be; observations are moved there when they are added. The estimate is on the CPU.
    """

    uses_gloss = True

    def __init__(
        self,
        model: LightModel,
        light_prior: Prior,
        albedo_prior: GaussianMixture,
        albedo_modes: Float[Tensor, "k 3"],
        options: SolverOptions | None = None,
    ) -> None:
        self.model = model
        self.light_prior = light_prior
        self.albedo_prior = albedo_prior
        self.albedo_modes = albedo_modes
        self.options = options or SolverOptions()
        self._levels = sorted({one.level for one in self.options.rounds})
        self._faces: list[_SkyFace] = []

    @property
    def grid_height(self) -> int:
        """Of the observations that it needs: the sky's rows and the ground's."""
        layout = self.model.grid.layout
        assert layout is not None
        return 2 * layout[0]

    def add(self, observation: Observation, photo: int = 0) -> None:
        """One more face; photographs come in order, counted from 0.

        Raises
        ------
        ValueError
            The observation's light is not on :attr:`grid_height` rows.
        """
        layout = observation.transport.grid.layout
        if layout is None or layout[0] != self.grid_height:
            raise ValueError(f"a sky needs transport of {self.grid_height} rows, got {layout}")
        mean = float(luminance(observation.pixels).mean())
        observation = observation.to(self.albedo_modes.device)
        levels = [observation.scaled(1 / mean)]
        while len(levels) <= max(1, self._levels[-1]):
            levels.append(levels[-1].coarser(1))
        face = _SkyFace(
            photo=photo,
            pyramid={k: FaceTerm.of(levels[k]) for k in self._levels},
            scanned=levels[1].on_rows(SCAN_HEIGHT),
            mean=mean,
        )
        self._faces.append(face)

    def solve(self, progress: Progress | None = None) -> Estimate:
        """Minimise Eq. 5.8 from the best of many starts, coarse to fine.

        Starts: the directions of the linear scan, each with the model's candidates, and the
        mixture's centroids turned to the best of them; each with the albedo modes that explain
        the picture best. All are scored on the coarsest level, the best few optimised as one
        batch, fewer on every finer level; the best end point wins.

        Raises
        ------
        InputError
            Nothing was added.
        """
        if not self._faces:
            raise InputError("there is no observation to estimate light from; give at least one")
        options, model = self.options, self.model
        photo_count = 1 + max(face.photo for face in self._faces)
        scales = [
            fmean(face.mean for face in self._faces if face.photo == k) for k in range(photo_count)
        ]
        objectives = {
            level: SkyObjective(
                [_scaled(face, level, scales[face.photo]) for face in self._faces],
                model,
                self.light_prior,
                self.albedo_prior,
                options.weights,
            )
            for level in self._levels
        }
        scan = scan_sun([f.scanned for f in self._faces], candidates=options.scan_candidates)
        objective = objectives[options.rounds[0].level]
        free, scores = choose_starts(objective, scan.candidates, self.albedo_modes)
        evaluations = nonfinite = 0
        result = None
        for number, effort in enumerate(options.rounds, start=1):
            objective = objectives[effort.level]
            result = minimise(
                objective,
                free[scores.argsort()[: effort.starts]],
                iterations=effort.iterations,
                tolerance=options.tolerance,
            )
            evaluations += result.evaluations
            nonfinite += result.nonfinite
            # in the tone to answer with, so that hue and light settle to it
            free = objective.at_bayes_scale(result.x)
            with torch.no_grad():
                scores = objective(free)
            if progress is not None:
                progress(number / len(options.rounds))
        assert result is not None
        best = int(scores.argmin())
        final = free[best : best + 1]
        with torch.no_grad():
            parts = objective.unpack(final)
            shadings = objective.shading(parts)
            sky = model(parts.light) * (parts.exposure[:, 0] * scales[0])[:, None, None]
            full = objective.ground.append(sky, parts.ground_albedo)[0].cpu()
            terms = {k: float(v) for k, v in objective.terms(final).items()}
        faces = tuple(
            FaceLight(
                photo=face.photo,
                exposure=float(parts.exposure[0, face.photo]) * scales[face.photo],
                albedo=parts.albedo[0, k].cpu(),
                gloss=float(parts.gloss[0, k]),
                rendered=(shadings[k][0] * scales[face.photo]).cpu(),
                residual=residual(
                    shadings[k][0], objective.faces[k].target, objective.faces[k].clipped
                ),
            )
            for k, face in enumerate(self._faces)
        )
        sky_layout = model.grid.layout
        assert sky_layout is not None
        environment = EnvironmentMap(radiance=full.reshape(2 * sky_layout[0], sky_layout[1], 3))
        status: Status = "converged" if bool(result.converged[best]) else "iteration limit"
        if nonfinite and status != "converged":
            status = "recovered from a non-finite step"
        sun = environment.brightest_direction()
        posterior = sun_posterior(
            sun_evidence([face.scanned for face in self._faces], scan.faces),
            sun,
            explained=all(face.residual <= UNEXPLAINED for face in faces),
            exposure=faces[0].exposure,
            albedo=faces[0].albedo,
            gloss=None if self._faces[0].scanned.gloss is None else faces[0].gloss,
            albedo_prior=objective.tone_prior,
        )
        return Estimate(
            light=model.name,
            environment=environment,
            params=parts.light[0].cpu(),
            ground_albedo=parts.ground_albedo[0].cpu(),
            sun_direction=sun,
            posterior=posterior,
            faces=faces,
            terms=terms,
            status=status,
            advice=advice(faces),
            stats={
                "evaluations": evaluations,
                "nonfinite": nonfinite,
                "scan_residual": float(scan.residuals.min()),
                "sun_strength": float(scan.strengths[0]),
            },
        )


def _scaled(face: _SkyFace, level: int, scale: float) -> FaceTerm:
    term, relative = face.pyramid[level], face.mean / scale
    return replace(term, target=term.target * relative, photo=face.photo, level=relative)
