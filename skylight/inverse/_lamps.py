"""Observations under one light -> lamps in ambient light, as many as the pictures tell of.

Eq. 5.8 is minimised for no lamp, one, two and three, as long as one more pays
(:class:`LampsProblem`, :func:`as_many_as_pay`). Where so many lamps could be is told
beforehand by a pursuit (:mod:`skylight.inverse._lamp_sets`).
"""

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from skylight._module import Module
from skylight.inverse._descent import Iterates, Stage, choose_starts, descend
from skylight.inverse._faces import Level, LitFaces, ObjectiveWeights, ScannedFace
from skylight.inverse._lamp_relighting import lamps_radiance
from skylight.inverse._lamp_sets import Pursuit
from skylight.inverse._objective import LightObjective
from skylight.inverse._posterior import LIKELIEST, credible, face_evidence, sun_evidence
from skylight.inverse._problem import LightProblem
from skylight.inverse._result import MAP_ROWS, SUN_SPREAD_RAD, Estimate, Lamp
from skylight.inverse._scan import SCAN_HEIGHT, FaceScan, SunScan, scan_faces
from skylight.inverse._scores import CAP_RAD, find_lamps
from skylight.inverse._sky import SkySolver, SolverOptions
from skylight.inverse._solution import Solutions, estimate_of, face_lights, log_evidence
from skylight.inverse._sun_prior import SunPrior, found_light
from skylight.models._base import Prior, without_azimuth
from skylight.models._ground import KnownGround
from skylight.models._lamps import LampsLight, LampsPrior
from skylight.models._lobes import LampedLight
from skylight.models._prior import GaussianMixture
from skylight.models._sphere import SpherePrior
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.transport._observation import Observation
from skylight.work._progress import Progress

NARROW_RAD = math.radians(4.0)  # of a lamp: faces cannot tell it from a sun


MOST_LAMPS = 3
EVIDENCE_PIXELS = 1  # the posterior reads pixels of half the resolution; starts need all
FAR = 30.0  # nats behind the likeliest: a group of starts that is not followed further
# Nats of evidence that one more lamp is to bring. What heads are wrong by is not as independent as
# the objective takes it to be, and lights a face as another lamp would: where the pictures of 15
# rendered faces under one sun were multiplied by smooth fields of 15 %, which makes residuals those
# of photographs, a second lamp brought up to 19.
LEAST_GAIN = 25.0
# Nats that the guide's first lamp is to bring for ambient light alone not to be tried: of 40
# simulated people none whose first lamp brought over 68 had no lamp in the end.
CERTAIN = 100.0
Point = TypeVar("Point")


@dataclass(frozen=True, kw_only=True)
class Fitted(Generic[Point]):
    """The best light of ``count`` lamps: a solver's own ``point``, and what numbers compete by."""

    count: int
    point: Point
    log_evidence: float


def as_many_as_pay(
    fitted: Callable[[int], Fitted[Point]],
    least_gain: float = LEAST_GAIN,
    patience: int = 1,
    most: int = MOST_LAMPS,
    fewest: int = 0,
) -> Fitted[Point]:
    """The ``fewest``, and one more as long as that brings ``least_gain`` of log evidence.

    ``fitted`` is asked for numbers of lamps in ascending order, up to the ``most``, until
    ``patience`` of them in a row did not pay: of two windows neither may pay alone. One that is
    less likely than without by as much ends it.
    """
    best, waited = fitted(fewest), 0
    for count in range(fewest + 1, most + 1):
        more = fitted(count)
        needed = least_gain * (more.count - best.count)
        if more.log_evidence >= best.log_evidence + needed:
            best, waited = more, 0
        elif more.log_evidence < best.log_evidence - least_gain or waited + 1 == patience:
            break
        else:
            waited += 1
    return best


@torch.no_grad()
def in_pictures_units(
    light: LampedLight,
    params: Float[Tensor, " p"],
    exposure: float | Float[Tensor, "3"],
    rows: int = MAP_ROWS,
    *,
    sunny: bool = False,
    clock: SunPrior | None = None,
) -> tuple[EnvironmentMap, tuple[Lamp, ...]]:
    """The map, of so many rows, and its lamps, the strongest first; on the CPU.

    ``exposure`` is the picture's unit, or one for each colour. Lamps are as wide as was found, but
    for the strongest of a ``sunny`` place, which is a sun if it is narrow, above the horizon and
    where the ``clock`` has the sun, if there is one: that is drawn as wide as the sun is, with the
    same irradiance.
    """
    model, params = light.on_rows(rows).cpu(), params.cpu()
    found = model.lamps(params)
    received = 4 * math.pi * found.energies * model.facing(found.widths_rad)
    lamps = [
        Lamp(
            direction=found.directions[k].double(),
            irradiance=received[k] * exposure * found.colours[k],
            spread_rad=float(found.widths_rad[k]),
        )
        for k in range(light.count)
    ]
    lamps.sort(key=lambda lamp: -float(luminance(lamp.irradiance)))
    if sunny and lamps and _like_a_sun(lamps[0], clock):
        lamps[0] = replace(lamps[0], spread_rad=SUN_SPREAD_RAD)
    radiance = model.ambient(params) * exposure + lamps_radiance(lamps, rows)
    shape = rows, 2 * rows, 3
    return EnvironmentMap(radiance=radiance.float().reshape(shape)), tuple(lamps)


def _like_a_sun(lamp: Lamp, clock: SunPrior | None) -> bool:
    narrow = lamp.spread_rad < NARROW_RAD and float(lamp.direction[1]) > 0
    return narrow and (clock is None or bool(clock.likely(lamp.direction[None])))


@dataclass(frozen=True, kw_only=True)
class LampsOptions:
    """Effort of the optimisation, as :class:`~skylight.inverse._sky.SolverOptions`.

    ``coarse`` are the stages with no lamp to three, each from the best ``sets`` of so many, one
    lamp from ``scan_candidates`` directions too; ``fine`` those with the number of lamps that
    was chosen.
    """

    scan_candidates: int = 6
    sets: int = 6
    coarse: tuple[Stage, ...] = (
        Stage(level=Level(2), starts=10, iterations=6, even_skin=True, steps="gauss-newton"),
        Stage(level=Level(1), starts=3, iterations=8, even_skin=True, steps="gauss-newton"),
    )
    fine: tuple[Stage, ...] = (
        Stage(level=Level(0), starts=1, iterations=8, steps="gauss-newton"),
        Stage(level=Level(0), starts=1, iterations=5, steps="gauss-newton"),
    )
    tolerance: float = 1e-4
    weights: ObjectiveWeights = ObjectiveWeights()

    @property
    def levels(self) -> list[Level]:
        return sorted({one.level for one in (*self.coarse, *self.fine)})


@torch.no_grad()
def kinds_of_place(objective: LightObjective, params: Float[Tensor, " p"]) -> dict[str, float]:
    """How likely light of these parameters is of each kind of place; nothing where none is known"""
    prior, model = objective.light_prior, objective.model
    if not isinstance(prior, SpherePrior):
        return {}
    free = without_azimuth(model, model.to_free(params.to(prior.means)))
    shares = prior.responsibilities(free).tolist()
    order = sorted(zip(prior.kinds, shares, strict=True), key=lambda pair: -pair[1])
    return dict(order)


@dataclass(frozen=True, kw_only=True)
class LampFamily:
    """Light models that differ by their number of lamps, and the prior of each.

    ``least_gain``, ``patience`` and ``most`` are those of :func:`as_many_as_pay`. Where ``smooth``
    light may be as uneven as lamps are, a main light may be seen though there is no lamp.
    ``apart`` makes groups of candidates (s,c,p) that are searched each by itself: the likeliest of
    what they lead to is chosen. The ``guide``, simpler light, is searched first, and its main lamp
    tells where this family's is looked for (:func:`~skylight.inverse._sun_prior.found_light`).
    """

    light: Callable[[int], LampedLight]
    prior: Callable[[int], Prior | None]
    least_gain: float = LEAST_GAIN
    patience: int = 1
    most: int = MOST_LAMPS
    smooth: bool = False
    apart: Callable[[Tensor], Sequence[Tensor]] = lambda candidates: [candidates]
    guide: "LampFamily | None" = None


LAMPS = LampFamily(light=LampsLight, prior=LampsPrior)


class LampsProblem(LightProblem):
    """Eq. 5.8 for all faces under one light of a ``family``, which is no sky.

    Light is on :data:`~skylight.inverse._scan.SCAN_HEIGHT` rows of the sphere: two thirds of the
    memory that a sky has, 130 MB for a face of 3,700 pixels with specular reflection. Everything is
    computed on the device of ``albedo_modes``, where the prior has to be. There are as many lamps
    as pay, or ``exactly`` so many. ``towards`` are directions that one lamp is looked for in
    besides those of the scan. ``sun_prior`` is what clock and place tell of the main light
    (:meth:`~skylight.inverse._sun_prior.SunPrior.anywhere`), ``ground`` the albedo below. Where
    a photograph shows that it was taken ``outdoors``, by day, that family takes the other's place,
    and its main light is the sun of clock and place.
    """

    uses_background = True

    def __init__(
        self,
        albedo_prior: GaussianMixture,
        albedo_modes: Float[Tensor, "k 3"],
        options: LampsOptions | None = None,
        family: LampFamily = LAMPS,
        exactly: int | None = None,
        towards: Float[Tensor, "d 3"] | None = None,
        sun_prior: SunPrior | None = None,
        ground: KnownGround | None = None,
        outdoors: LampFamily | None = None,
    ) -> None:
        self.family, self.exactly, self.towards = family, exactly, towards
        self.outdoors, self._anywhere = outdoors, (family, sun_prior)
        self.albedo_prior, self.albedo_modes = albedo_prior, albedo_modes
        self.options = options or LampsOptions()
        self.faces, self.ground = LitFaces(sun_prior), ground

    def another(self) -> "LampsProblem":
        """An empty problem with the same family, priors and options, wherever this one's was."""
        problem = copy(self)
        problem.family, sun_prior = self._anywhere
        problem.faces = LitFaces(sun_prior)
        return problem

    def with_lamps(self, count: int, family: LampFamily | None = None) -> SkySolver:
        """The model of so many lamps with its priors, for those who know how many there are."""
        family = family or self.family
        device, prior = self.albedo_modes.device, family.prior(count)
        return SkySolver(
            model=family.light(count).on_rows(SCAN_HEIGHT).to(device),
            light_prior=prior.to(device) if isinstance(prior, Module) else prior,
            albedo_prior=self.albedo_prior,
            albedo_modes=self.albedo_modes,
            options=SolverOptions(weights=self.options.weights, ground=self.ground),
        )

    @property
    def grid_height(self) -> int:
        return SCAN_HEIGHT

    @property
    def is_empty(self) -> bool:
        return not self.faces

    def add(self, observation: Observation, photo: int = 0) -> None:
        coarse = observation.on_rows(SCAN_HEIGHT)
        if self.outdoors and coarse.background is not None and coarse.background.outdoors:
            self.family, clock = self.outdoors, self.faces.sun_prior
            self.faces.sun_prior = clock and clock.anywhere(open_sky=1.0)
        device, levels = self.albedo_modes.device, self.options.levels
        self.faces.append(ScannedFace.of(coarse, photo, levels, device, sphere=True))

    def _solve(self, progress: Progress) -> Estimate:
        """Ambient light alone, then one lamp more as long as that is likelier.

        Each number of lamps starts from the sets that explain the face best (:class:`Pursuit`), one
        lamp also from the directions of the scan over the sphere. Numbers compete on a coarse level
        by :func:`~skylight.inverse._solution.log_evidence`: one more is to bring
        :data:`LEAST_GAIN`. Groups of starts that are :data:`FAR` behind after the coarsest level
        are not followed.

        Where the family has a guide, and no clock tells, that is searched first. Smooth light of
        many latents takes over a part of a lamp, which pulls that 5 to 30 degrees aside on real
        faces, at no higher residuals; even light cannot. What the guide tells counts as a clock
        does, but not in the posterior, whose scan is of the same pixels: a number of lamps with one
        there gains up to 5 nats of the least gain, so one lamp that the guide has needs 3 more.
        Beside smooth light a lamp brings less than beside even light, so at most one more than
        the guide has is tried, and that only where it brought the guide what it is to bring here:
        of 15 simulated people where it did not, it would have paid for one, by 0.4 nats. Where the
        guide's first lamp is :data:`CERTAIN`, light without one is not tried.

        What clock and place tell of the sun counts unless the faces contradict it, as of skies. One
        lamp is looked for where they say too, they choose between lights that explain the faces,
        and draw the sun's lamp in the end. Not before: what a face is explained less well by a lamp
        that is drawn, another lamp would explain, so evidence is that of lights which are not
        drawn. Its logarithm grows by that of the sun's density over an even one. As that is 1 in
        the mean over all directions for any number of lamps, and 1 for none, no number is
        preferred beforehand.
        """
        options, fewest, most = self.options, 0, self.family.most
        observed = [face.scanned for face in self.faces]
        every = scan_faces(observed, sphere=True)
        coarse = [one.coarser(EVIDENCE_PIXELS) for one in observed]
        scans = scan_faces(coarse, sphere=True, before=every, likeliest=LIKELIEST)
        evidence = sun_evidence(face_evidence(coarse, scans, sphere=True))
        pursuit = Pursuit(observed)
        clock = credible(evidence, self.faces.sun_prior)
        if clock is None and self.family.guide is not None:
            clock, fewest, most = self._told_by(self.family.guide, pursuit, every)
        scan = SunScan.of(every, candidates=options.scan_candidates, sun_prior=clock)

        def fitted(count: int) -> Fitted[Iterates]:
            return self._fitted(self.family, count, pursuit, scan, clock)

        if self.exactly is not None:
            best = fitted(self.exactly)
        else:
            least_gain, patience = self.family.least_gain, self.family.patience
            best = as_many_as_pay(fitted, least_gain, patience, most, fewest)
        solver, points = self.with_lamps(best.count), best.point
        for number, stage in enumerate(options.fine, start=1):
            objective = self._objective(solver, stage, clock)
            (points,) = descend(objective, [points], stage, options.tolerance)
            progress(number / len(options.fine))
        solutions = Solutions.of(objective, [points], evidence=True)
        params = solutions.parts.light[0].cpu()
        lights = face_lights(solutions, 0, self.faces, options.fine[-1].level)
        light = self.family.light(best.count)
        kinds = kinds_of_place(objective, params)
        environment, lamps = in_pictures_units(
            light,
            params,
            lights[0].exposure,
            sunny=kinds.get("outdoors", 0.0) > 0.5,
            clock=self.faces.sun_prior,
        )
        return estimate_of(
            objective.model.name,
            params,
            environment,
            lights,
            solutions.search(0, scan),
            evidence,
            sun=self._main_light(environment, lamps),
            albedo_prior=objective.tone_prior,
            reflects=self.faces[0].scanned.specular is not None,
            sun_prior=self.faces.sun_prior,
            lamps=lamps,
            seen=None if self.family.smooth else bool(lamps),
            kinds=kinds,
        )

    def _told_by(
        self, guide: LampFamily, pursuit: Pursuit, every: Sequence[FaceScan]
    ) -> tuple[SunPrior | None, int, int]:
        """(where the main lamp is in the light of the guide, how few lamps are worth a try, and
        how many).

        None where that has no lamp.
        """
        scan = SunScan.of(every, candidates=self.options.scan_candidates)
        nats: dict[int, float] = {}

        def fitted(count: int) -> Fitted[Iterates]:
            found = self._fitted(guide, count, pursuit, scan, None)
            nats[count] = found.log_evidence
            return found

        best = as_many_as_pay(fitted, guide.least_gain, guide.patience, guide.most)
        more = best.count + 1
        worth = (
            not best.count or nats.get(more, -math.inf) > nats[best.count] + self.family.least_gain
        )
        most = min(more if worth else best.count, self.family.most)
        if not best.count:
            return None, 0, most
        light = guide.light(best.count)
        free = best.point.free[best.point.scores.argmin()]
        found = light.lamps(light.from_free(free[: light.parameter_count].cpu()))
        main = found.directions[int(found.energies.argmax())].double()
        return found_light(main), int(nats[1] > nats[0] + CERTAIN), most

    def _fitted(
        self,
        family: LampFamily,
        count: int,
        pursuit: Pursuit,
        scan: SunScan,
        clock: SunPrior | None,
    ) -> Fitted[Iterates]:
        """The best light of so many lamps, on the coarse levels."""
        solver, weights = self.with_lamps(count, family), self.options.weights
        stages = [(stage, self._objective(solver, stage)) for stage in self.options.coarse]
        objective = stages[0][1]
        model = objective.model
        assert isinstance(model, LampedLight)
        towards = pursuit.starts(model, self.options.sets)
        if count == 1:
            tried = [scan.candidates, *([] if self.towards is None else [self.towards])]
            scanned = [model.starts_towards(each).to(towards) for each in tried]
            towards = torch.cat([towards, *scanned])
        turns = model.azimuth_index is not None  # to where the sets are, as starts are not
        groups = [
            Iterates.starting(
                *choose_starts(objective, some, self.albedo_modes, centroids=not turns)
            )
            for some in family.apart(towards)
        ]

        def drawn_by(told: Sequence[Tensor], points: Sequence[Iterates]) -> list[Iterates]:
            return [
                replace(one, scores=one.scores - weights.sun_prior * t)
                for one, t in zip(points, told, strict=True)
            ]

        groups = drawn_by([_sun_log_density(objective, one, clock) for one in groups], groups)
        for stage, objective in stages:
            ends = descend(objective, groups, stage, self.options.tolerance)
            told = [_sun_log_density(objective, one, clock) for one in ends]
            costs = [one.scores - t for one, t in zip(ends, told, strict=True)]
            best = [cost.argmin() for cost in costs]
            drawn = drawn_by(told, ends)
            least = min(float(cost.min()) for cost in costs)
            # what the evidence is that of goes on too
            groups = [
                replace(one, scores=one.scores.index_fill(0, at, one.scores.min()))
                for one, at, cost in zip(drawn, best, costs, strict=True)
                if float(cost.min()) < least + FAR
            ]
        minima = [one.free[at] for one, at in zip(drawn, best, strict=True)]
        nats = log_evidence(objective, torch.stack(minima))
        nats = nats + torch.stack([t[at] for t, at in zip(told, best, strict=True)])
        likeliest = int(nats.argmax())
        return Fitted(count=count, point=drawn[likeliest], log_evidence=float(nats[likeliest]))

    def _main_light(
        self, environment: EnvironmentMap, lamps: Sequence[Lamp]
    ) -> Float[Tensor, "3"] | None:
        """Where the strongest lamp is, or what the ``smooth`` light has that is stronger."""
        if not lamps:
            return None
        of_map = find_lamps(environment, most=1, least_share=0.0) if self.family.smooth else []
        if not of_map:
            return lamps[0].direction
        main = of_map[0].direction.double()
        nearest = max(lamps, key=lambda lamp: float(lamp.direction @ main)).direction
        return nearest if float(nearest @ main) > math.cos(CAP_RAD) else main

    def _objective(
        self, solver: SkySolver, stage: Stage, clock: SunPrior | None = None
    ) -> LightObjective:
        return solver.objective([self.faces], [clock], stage)


@torch.no_grad()
def _sun_log_density(
    objective: LightObjective, points: Iterates, clock: SunPrior | None
) -> Float[Tensor, " s"]:
    """What clock and place tell of each point's lamps, over the even density; 0 without any."""
    suns = objective.suns(objective.unpack(points.free).light)
    if clock is None or suns is None:
        return torch.zeros_like(points.scores)
    return clock.of_one(suns) + math.log(clock.area)
