"""Observations under one sky -> that sky, of one light or of several as one batch.

So are models of the whole sphere solved for, of the user's own; what differs is that they have no
ground, and that suns are looked for all round.

Eq. 5.8 is minimised coarse to fine, from many starts that a linear scan for the sun proposes, or,
as in the thesis, from the mean sky turned to where light comes from in the mean
(:func:`linear_direction`).
"""

from collections import defaultdict
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import islice
from typing import Literal, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from skylight._names import SolverName
from skylight.errors import InputError
from skylight.inverse._descent import Iterates, Stage, choose_starts, descend
from skylight.inverse._faces import FaceTerm, Level, LitFaces, ObjectiveWeights, ScannedFace
from skylight.inverse._objective import LightObjective
from skylight.inverse._posterior import SunEvidence, credible, face_evidence, sun_evidence
from skylight.inverse._problem import LightProblem
from skylight.inverse._result import MAP_ROWS, Estimate
from skylight.inverse._scan import SunScan, scan_faces
from skylight.inverse._solution import Solutions, estimate_of, face_lights
from skylight.inverse._sun_prior import SunPrior
from skylight.models._base import LightModel, Prior
from skylight.models._ground import KnownGround, LambertianGround
from skylight.models._harmonic import solve_linear
from skylight.models._prior import GaussianMixture
from skylight.models.autoencoder import AutoencoderLight
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import angles_from_direction
from skylight.transport._observation import Observation
from skylight.work._progress import Progress

T = TypeVar("T")
BELOW_ZERO = 1e-6  # of the largest radiance: less is rounding


@dataclass(frozen=True, kw_only=True)
class SolverOptions:
    """Effort of the optimisation: directions taken from the scan, then stages, coarse to fine.

    Many starts matter: from three, faces lit from behind ended in minima up to 50 nats above those
    that ten find. The coarsest level, on which suns compete, has even skin: pigments that settle
    beside a sun that is wrong excuse it. The last stages take Gauss-Newton steps: twenty of L-BFGS
    ended up to 100 nats above where these do, with suns that were not yet where the face has them.

    With a ``start`` from the "mean" there is one: the mean of all latents, its azimuth that of
    :func:`~skylight.inverse._sky.linear_direction`.

    With ``evidence`` the estimate tells how likely the faces are under the model, which takes as
    many derivatives of the sky as that has parameters.

    ``ground`` is the ground's albedo where it is known, in place of what is usual.
    """

    start: Literal["scan", "mean"] = "scan"
    scan_candidates: int = 10
    stages: tuple[Stage, ...] = (
        Stage(level=Level(2, light=1), starts=10, iterations=6, even_skin=True),
        Stage(level=Level(2, light=1), starts=4, iterations=10, even_skin=True),
        Stage(level=Level(1, light=1), starts=2, iterations=12),
        Stage(level=Level(0), starts=1, iterations=8, steps="broyden"),
        Stage(level=Level(0), starts=1, iterations=4, steps="broyden"),
    )
    tolerance: float = 1e-4
    weights: ObjectiveWeights = ObjectiveWeights()
    evidence: bool = False
    ground: KnownGround | None = None


# Thesis, B.1: pyramids of four levels for face and light, on each L-BFGS until it converges (or
# 100 steps), from the mean of the latents. What is minimised is as for a scan's starts, with
# specular reflection, pigments, white balance and wrong normals, which B.1 has not.
THESIS = SolverOptions(
    start="mean",
    stages=tuple(Stage(level=Level(k, light=k), starts=1, iterations=100) for k in (3, 2, 1, 0)),
)
SOLVERS: dict[SolverName, SolverOptions] = {"scan": SolverOptions(), "thesis": THESIS}


@dataclass(frozen=True, kw_only=True, eq=False)
class SkySolver:
    """A light model, its prior, those of skin and ground, and the effort to spend.

    Everything is computed on the device of ``albedo_modes``. Without a light prior all free
    parameters of the model are alike.
    """

    model: LightModel
    light_prior: Prior | None
    albedo_prior: GaussianMixture
    albedo_modes: Float[Tensor, "k 3"]
    options: SolverOptions

    def solve(
        self, problems: Sequence[LitFaces], progress: Progress | None = None
    ) -> list[Estimate]:
        """The sky of each problem; all have one :attr:`LitFaces.shape`.

        Starts (of a scan): the directions of the linear scan, each with the model's candidates,
        and the mixture's centroids turned to the best of them; each with the albedo modes that
        explain the picture best. All are scored on the coarsest level, the best few optimised,
        fewer on every finer level; the best end point wins. In each stage the starts of all
        problems are one batch, and a problem's end does not depend on the others but for
        rounding.

        What clock and place tell of the sun counts unless the faces contradict it
        (:func:`~skylight.inverse._posterior.credible`): else a wrong clock would draw the sun.
        """
        stages, observed = self.options.stages, [face.scanned for one in problems for face in one]
        sphere = self.model.grid.is_sphere
        every = scan_faces(observed, sphere=sphere)
        evidence = [
            sun_evidence(each)
            for each in _per_problem(face_evidence(observed, every, sphere=sphere), problems)
        ]
        priors = [
            credible(each, problem.sun_prior)
            for each, problem in zip(evidence, problems, strict=True)
        ]
        scans = [
            SunScan.of(faces, candidates=self.options.scan_candidates, sun_prior=prior)
            for faces, prior in zip(_per_problem(every, problems), priors, strict=True)
        ]
        points = [
            self.starts(faces, prior, scan.candidates)
            for faces, prior, scan in zip(problems, priors, scans, strict=True)
        ]
        before, objective = None, None
        for number, stage in enumerate(stages, start=1):
            kind = stage.level, stage.even_skin
            if objective is None or kind != before:
                objective = None  # of many faces, one level at a time is much memory
                before, objective = kind, self.objective(problems, priors, stage)
            points = descend(objective, points, stage, self.options.tolerance)
            if progress is not None:
                progress(number / len(stages))
        assert objective is not None
        solutions = Solutions.of(objective, points, evidence=self.options.evidence)
        return [
            _estimate(solutions, p, faces, stages[-1].level, scan, each)
            for p, (faces, scan, each) in enumerate(zip(problems, scans, evidence, strict=True))
        ]

    def objective(
        self, problems: Sequence[LitFaces], priors: Sequence[SunPrior | None], stage: Stage
    ) -> LightObjective:
        """Of all problems on a stage's level; of one, without a copy of its transport."""
        faces = zip(*(one.terms(stage.level) for one in problems), strict=True)
        weights, model = self.options.weights, self.model
        assert model.grid.layout is not None
        return LightObjective(
            [FaceTerm.together(terms) for terms in faces],
            model.on_rows(model.grid.layout[0] >> stage.level.light),
            self.light_prior,
            self.albedo_prior,
            replace(weights, pigment_spread=0.0) if stage.even_skin else weights,
            priors,
            self.options.ground,
        )

    def starts(
        self, faces: LitFaces, prior: SunPrior | None, directions: Float[Tensor, "d 3"]
    ) -> Iterates:
        """Where descent begins towards each direction and from the mixture's centroids."""
        objective = self.objective([faces], [prior], self.options.stages[0])
        if self.options.start == "mean":
            towards = self._mean(linear_direction([face.scanned for face in faces]))
        else:
            towards = self.model.starts_towards(directions.to(self.albedo_modes))
        found = choose_starts(
            objective, towards, self.albedo_modes, centroids=self.options.start != "mean"
        )
        return Iterates.starting(*found)

    def _mean(self, direction: Float[Tensor, "3"]) -> Float[Tensor, "1 1 p"]:
        """The mean of all latents, turned to a direction."""
        if not isinstance(self.model, AutoencoderLight):
            raise InputError(f"{self.model.name} has no mean to start from: only latents have")
        free = self.albedo_modes.new_zeros(1, 1, self.model.parameter_count)
        free[..., self.model.azimuth_index] = float(angles_from_direction(direction)[0])
        return self.model.from_free(free)


@torch.no_grad()
def environment_of(
    model: LightModel,
    params: Float[Tensor, " p"],
    ground_albedo: Float[Tensor, " g"],
    exposure: float,
) -> EnvironmentMap:
    """The map, of :data:`MAP_ROWS` rows, in a picture's units, on the CPU: a sky over its ground.

    :class:`InputError` where that is no light.
    """
    rows = MAP_ROWS if model.grid.is_sphere else MAP_ROWS // 2
    light = model.on_rows(rows)(params[None])[0] * exposure
    require_light(light, model.name, "the parameters found")
    light = light.cpu().clamp(min=0)
    if model.grid.is_sphere:
        full = light
    else:
        full = LambertianGround(rows).append(light, ground_albedo.cpu())
    return EnvironmentMap(radiance=full.reshape(MAP_ROWS, 2 * MAP_ROWS, 3))


def require_light(radiance: Float[Tensor, "*batch n 3"], name: str, at: str) -> None:
    """:class:`InputError` where ``name`` radiates what no light does."""
    if not bool(radiance.isfinite().all()):
        raise InputError(
            f"{name}: radiance at {at} is not finite: bound what is exponentiated or divided by"
        )
    least = float(radiance.min())
    if least < -BELOW_ZERO * float(radiance.max()):
        raise InputError(
            f"{name}: radiance at {at} is negative ({least:.3g}): end forward with exp, softplus "
            "or clamp(min=0)"
        )


def _estimate(
    solutions: Solutions,
    p: int,
    faces: LitFaces,
    level: Level,
    scan: SunScan,
    evidence: SunEvidence,
) -> Estimate:
    """The answer to problem ``p``, in its photographs' units and on the CPU."""
    parts, model = solutions.parts, solutions.objective.model
    lights = face_lights(solutions, p, faces, level)
    environment = environment_of(model, parts.light[p], parts.ground_albedo[p], lights[0].exposure)
    sun = _sun(model, parts.light[p], environment)
    found = estimate_of(
        model.name,
        parts.light[p].cpu(),
        environment,
        lights,
        solutions.search(p, scan),
        evidence,
        sun=sun,
        albedo_prior=solutions.objective.tone_prior,
        reflects=faces[0].scanned.specular is not None,
        sun_prior=faces.sun_prior,
        ground_albedo=None if model.grid.is_sphere else parts.ground_albedo[p].cpu(),
    )
    if sun is None:
        return replace(found, sun_direction=environment.brightest_direction(below=True))
    return found


def _sun(
    model: LightModel, params: Float[Tensor, " p"], environment: EnvironmentMap
) -> Float[Tensor, "3"] | None:
    """A sky's, to a pixel, or the one that a model of the whole sphere has."""
    if not model.grid.is_sphere:
        return environment.brightest_direction()
    sun = model.sun_direction(params[None])
    return None if sun is None else normalize(sun[0].double().cpu(), dim=0)


def _per_problem(every: Sequence[T], problems: Sequence[LitFaces]) -> list[list[T]]:
    """What there is for each face, by problem."""
    rest = iter(every)
    return [list(islice(rest, len(faces))) for faces in problems]


# A face sees half of the directions, and a sun has more than nine harmonics: with less than this
# the fit puts light behind the face that cancels what is left of the sun in front.
_RIDGE = 1e-2


def linear_direction(observations: Sequence[Observation]) -> Float[Tensor, "3"]:
    """The direction of ``int L(w) w dw``, L the nine harmonics that explain faces best.

    The light is fitted to the pixels, channels averaged, by weighted least squares
    (:func:`solve_linear`); its moment is that of the three harmonics of degree 1 (Green 2003,
    "Spherical harmonic lighting: the gritty details"). Of several faces the fits'
    directions add up. Of a ball under a clear sky its azimuth is within 12 degrees of the sun's.
    """
    total = torch.zeros(3, dtype=torch.float64)
    for seen in observations:
        grid = seen.transport.grid
        basis = harmonics.evaluate(grid.directions, 2).double()
        weights = seen.weights.double()
        if seen.clipped is not None:  # a linear fit has no use for bounds
            weights = weights * ~seen.clipped
        shading = seen.transport.matrix.double().cpu() @ basis
        light = basis @ solve_linear(
            shading, seen.pixels.double().cpu(), weights.cpu(), ridge=_RIDGE
        ).mean(1)
        total += normalize((light * grid.solid_angles) @ grid.directions, dim=0)
    return normalize(total, dim=0)


class SkyProblem(LightProblem):
    """Eq. 5.8 for all faces under one sky, to be solved with :meth:`another`'s as one batch.

    The faces of one photograph share its exposure. Of an observation's transport only the
    sky's half is kept, folded with the ground: with the pyramid 0.7 times as much memory as
    the observation's own, 35 MB for a face in 700 blocks of pixels seen on 64 rows with specular
    reflection.

    Problems of one shape, with as many faces in the same photographs, all with specular reflection
    or none and all grey or none, are solved as one batch; numbers of pixels may differ. What a
    problem holds is copied level by level, padded to the most pixels: beside the 185 MB of a face
    of 3,700 pixels with specular reflection that is up to 120 MB, 9 GB for a batch of 32 such
    faces, and 1.3 GB for the autoencoder's gradients with respect to ten starts of each.

    Everything is computed on the device of ``albedo_modes``, where ``model`` and the priors have
    to be; observations are moved there when they are added. The estimate is on the CPU.
    """

    def __init__(
        self,
        model: LightModel,
        light_prior: Prior | None,
        albedo_prior: GaussianMixture,
        albedo_modes: Float[Tensor, "k 3"],
        options: SolverOptions | None = None,
        sun_prior: SunPrior | None = None,
    ) -> None:
        self.solver = SkySolver(
            model=model,
            light_prior=light_prior,
            albedo_prior=albedo_prior,
            albedo_modes=albedo_modes,
            options=options or SolverOptions(),
        )
        self.faces = LitFaces(sun_prior)

    def another(self, sun_prior: SunPrior | None = None) -> "SkyProblem":
        """An empty problem with the same model, priors and options, to be solved with this one.

        What clock and place tell of the sun is its own.
        """
        problem = copy(self)
        problem.faces = LitFaces(sun_prior)
        return problem

    @property
    def grid_height(self) -> int:
        """The sky's rows and the ground's, or the sphere's."""
        grid = self.solver.model.grid
        assert grid.layout is not None
        return grid.layout[0] if grid.is_sphere else 2 * grid.layout[0]

    @property
    def is_empty(self) -> bool:
        return not self.faces

    def add(self, observation: Observation, photo: int = 0) -> None:
        layout, model = observation.transport.grid.layout, self.solver.model
        if layout is None or layout[0] % self.grid_height:
            raise InputError(
                f"{model.name} needs transport of {self.grid_height} rows, or a multiple of them, "
                f"got {layout}: observe_face(grid_height={self.grid_height}) makes it"
            )
        levels = sorted({one.level for one in self.solver.options.stages})
        # what stands below a real horizon is no sky over even ground
        observation = replace(observation, background=None)
        coarse, device = observation.on_rows(self.grid_height), self.solver.albedo_modes.device
        sphere = model.grid.is_sphere
        self.faces.append(ScannedFace.of(coarse, photo, levels, device, sphere=sphere))

    def _solve(self, progress: Progress) -> Estimate:
        return self.solver.solve([self.faces], progress)[0]

    @classmethod
    def _solve_each(cls, problems: Sequence["SkyProblem"], progress: Progress) -> list[Estimate]:
        """As batches of one shape each; all are :meth:`another` of the first."""
        solver = problems[0].solver
        if any(problem.solver is not solver for problem in problems):
            raise ValueError("problems solved together share a solver: make them by another()")
        groups: dict[tuple, list[int]] = defaultdict(list)
        for number, problem in enumerate(problems):
            groups[problem.faces.shape].append(number)
        found: dict[int, Estimate] = {}
        for done, numbers in enumerate(groups.values()):

            def partial(share: float, done: int = done) -> None:
                progress((done + share) / len(groups))

            estimates = solver.solve([problems[k].faces for k in numbers], partial)
            found.update(zip(numbers, estimates, strict=True))
        return [found[k] for k in range(len(problems))]
