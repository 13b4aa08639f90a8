"""One light over a film: a light that drifts slowly, skin that stays, exposures of each frame.

Every keyframe k is a face in the objective of :mod:`skylight.inverse._objective`,
its transport in the world's frame (:func:`in_world`). What all share are the sky's free parameters
x_k, which drift (a random walk, whose strength is found from the data), and albedo, specular scale
and ground, which do not; exposure, white balance and what the head's normals are wrong by are each
frame's own.

The start is one light for a few keyframes. Then, several times: each frame's likelihood becomes its
Laplace approximation about the light found so far, with its own unknowns eliminated (Schur's
complement of a Gauss-Newton Hessian), and all are smoothed in time
(:mod:`skylight.estimation.film._smoother`). Frames of one head err alike, and more than each says
itself: the noise of the sights is found from the data too.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from scipy.sparse import csr_matrix
from torch import Tensor

from skylight.estimation.film._smoother import (
    DRIFTS,
    Drifting,
    Sight,
    covariance_of,
    likeliest,
    smooth,
)
from skylight.imaging._edits import Edit
from skylight.inverse._descent import Stage, best_exposure, deviations, jacobian
from skylight.inverse._faces import Level, LitFaces, ScannedFace
from skylight.inverse._gauss_newton import charbonnier
from skylight.inverse._lamps import LampsProblem, in_pictures_units
from skylight.inverse._least_squares import curvatures
from skylight.inverse._objective import LightObjective
from skylight.inverse._problem import solve
from skylight.inverse._result import Estimate, Lamp, residual
from skylight.inverse._sky import SkyProblem, SkySolver, environment_of
from skylight.inverse._solution import measured_ground
from skylight.models._lobes import LampedLight
from skylight.models._prior import convex_shape
from skylight.sphere._envmap import EnvironmentMap, bilinear_taps
from skylight.sphere._frame import DirectionGrid, pixel_from_direction
from skylight.transport._matrix import TransportMatrix
from skylight.transport._observation import Observation
from skylight.work._progress import Progress

STARTING = 4  # keyframes of the start
_ROUNDS = 2
_GROUP = 12  # keyframes whose derivatives are taken together: memory grows with their square
SHARE_OF_START = 0.5  # in what progress is told
_FULL = Stage(level=Level(0), starts=1, iterations=1)
_SHARED_PRIORS = ("light_prior", "albedo_prior", "ground_prior", "gloss_prior", "sun_prior")
# The variance of an azimuth that may be anything, as whitened parameters have a variance of 1,
_ANY_AZIMUTH = np.pi**2 / 3
# and what it gains in a second by a drift of 1: the fastest drift turns the sky by 2.5 degrees in
# ten minutes, as the sun does.
_TURNING = np.radians(2.5) ** 2 / (600 * DRIFTS[1])
_SKIN = 4  # of a face's unknowns: specular scale and albedo; the rest are its normals'


@dataclass(frozen=True, kw_only=True)
class FrameLight:
    """The light at a keyframe, in the world's frame and the frame's own radiance units.

    ``params`` and ``ground_albedo`` give ``environment``, whose ``lamps`` are those of light that
    has some; ``azimuth_spread_rad`` is the standard deviation of the light's azimuth. ``residual``
    is as :attr:`~skylight.inverse._result.FaceLight.residual`.
    """

    time_s: float
    params: Float[Tensor, " p"]
    environment: EnvironmentMap
    sun_direction: Float[Tensor, "3"]
    azimuth_spread_rad: float | None
    exposure: float
    white_balance: Float[Tensor, "3"]
    edit: Edit
    residual: float
    lamps: tuple[Lamp, ...] = ()


@dataclass(frozen=True, kw_only=True)
class FilmLight:
    """The light of a film: at each keyframe, and ``mean``, of the mean parameters.

    ``mean`` is in the units of the first keyframe; ``start`` the light of the few keyframes that it
    began with. ``drift_per_s`` is the variance that the light's parameters gain in a second, of 1
    that they have a priori, and ``noise`` by how much more the variance of each frame's sight is
    than it says itself.
    """

    frames: tuple[FrameLight, ...]
    mean: FrameLight
    start: Estimate
    ground_albedo: Float[Tensor, "3"]
    albedo: Float[Tensor, "3"]
    specular_scale: float
    drift_per_s: float
    noise: float


class FilmProblem:
    """Give it each keyframe's observation in the world's frame, in order of time; then solve.

    ``problem`` is an empty one whose model and priors count. Of light with lamps the start says how
    many there are; what stands behind the person is not looked at.
    """

    def __init__(self, problem: SkyProblem | LampsProblem) -> None:
        self._empty = problem
        self._frames: list[LitFaces] = []
        self.times_s: list[float] = []

    def add(self, observation: Observation, time_s: float) -> None:
        """One more keyframe, later than the one before."""
        one = self._empty.another()
        one.add(replace(observation, background=None))
        self._frames.append(one.faces)
        self.times_s.append(time_s)

    def solve(self, progress: Progress | None = None) -> FilmLight:
        """The light of all keyframes, of which there is at least one; see the module's text."""
        tell = progress or (lambda _share: None)
        start = self._start(lambda share: tell(SHARE_OF_START * share))
        film = _Film(self._solver(start), self._frames, self.times_s, start)
        for number in range(_ROUNDS):
            film.improve()
            tell(SHARE_OF_START + (1 - SHARE_OF_START) * (number + 1) / _ROUNDS)
        return film.answer(start)

    def _start(self, progress: Progress) -> Estimate:
        """One light for a few keyframes, spread evenly."""
        count = min(STARTING, len(self._frames))
        chosen = np.unique(np.linspace(0, len(self._frames) - 1, count).round().astype(int))
        together = self._empty.another()
        together.faces.extend(_photographs([self._frames[k] for k in chosen]))
        return solve([together], progress)[0]

    def _solver(self, start: Estimate) -> SkySolver:
        """The model and priors of the light found, as many lamps as it has."""
        if isinstance(self._empty, LampsProblem):
            return self._empty.with_lamps(len(start.lamps))
        return self._empty.solver


class _Film:
    """The trajectory found so far: free parameters (K, q) of one objective for each keyframe."""

    def __init__(
        self,
        solver: SkySolver,
        frames: Sequence[LitFaces],
        times_s: Sequence[float],
        start: Estimate,
    ) -> None:
        self.model, self.times_s, self.faces = solver.model, np.array(times_s), frames
        self.objectives = [solver.objective([faces], [None], _FULL) for faces in frames]
        light, camera, _, ground = self.objectives[0].sizes
        index = np.arange(self.objectives[0].size)
        own = np.concatenate([index[light : light + camera], index[light + camera + _SKIN :]])
        self.own = own[own < len(index) - ground]
        self.shared = np.setdiff1d(index, self.own)
        self.lights = light
        self.sunny = any(lamp.is_sun for lamp in start.lamps)
        self.free = torch.cat([_starting(objective, start) for objective in self.objectives])
        self.groups = [
            _together(solver, frames[i : i + _GROUP]) for i in range(0, len(frames), _GROUP)
        ]
        self.drift, self.noise = 0.0, 1.0
        self.spreads: Float[np.ndarray, " k"] | None = None

    def improve(self) -> None:
        """One step of Gauss and Newton for all keyframes, halved until it is no worse."""
        changes = self._changes()
        shapes = [self._shape(k, change) for k, change in enumerate(changes)]
        at = self.free[:, self.shared].double().numpy()
        sights = [
            Sight.of_minimum(x, shape.slope, shape.hessian)
            for x, shape in zip(at, shapes, strict=True)
        ]
        model = self._drifting(at[0])
        if len(sights) > 1:
            self.drift, self.noise = likeliest(model, sights)
        found = smooth(model, sights, drift=self.drift, noise=self.noise)
        step = torch.zeros_like(self.free, dtype=torch.float64)
        for k, shape in enumerate(shapes):
            shared = found.means[k] - at[k]
            step[k, self.shared] = torch.from_numpy(shared)
            step[k, self.own] = torch.from_numpy(-shape.own_slope - shape.own_by_shared @ shared)
        before, share = self._cost(self.free, model), 1.0
        for _ in range(6):
            trial = (self.free.double() + share * step).float()
            if self._cost(trial, model) <= before:
                self.free = trial
                break
            share /= 2
        azimuth = self.model.azimuth_index
        if azimuth is not None:
            self.spreads = np.sqrt(found.covariances[:, azimuth, azimuth])

    def answer(self, start: Estimate) -> FilmLight:
        frames = []
        for k, time_s in enumerate(self.times_s):
            spread = None if self.spreads is None else float(self.spreads[k])
            frames.append(self._frame(k, self.free[k], float(time_s), spread))
        middle = self.free[0].clone()
        middle[self.shared] = self.free[:, self.shared].mean(0)
        mean = self._frame(0, middle, float(self.times_s.mean()), None)
        parts = self.objectives[0].unpack(middle[None])
        return FilmLight(
            frames=tuple(frames),
            mean=mean,
            start=start,
            ground_albedo=measured_ground(mean.environment)
            if self.model.grid.is_sphere
            else parts.ground_albedo[0],
            albedo=parts.albedo[0, 0],
            specular_scale=float(parts.specular_scale[0, 0]),
            drift_per_s=self.drift,
            noise=self.noise,
        )

    @torch.no_grad()
    def _frame(
        self, k: int, free: Float[Tensor, " q"], time_s: float, spread: float | None
    ) -> FrameLight:
        objective, face = self.objectives[k], self.faces[k][0]
        parts = objective.unpack(free[None])
        exposure = float(parts.exposure[0, 0]) * face.mean
        lamps: tuple[Lamp, ...] = ()
        if isinstance(self.model, LampedLight):
            environment, lamps = in_pictures_units(
                self.model, parts.light[0], exposure, sunny=self.sunny
            )
        else:
            environment = environment_of(
                self.model, parts.light[0], parts.ground_albedo[0], exposure
            )
        brightest = environment.brightest_direction(below=self.model.grid.is_sphere)
        term = objective.faces[0]
        shading = term.seen(objective.shading(parts)[0][0])
        clipped = None if term.clipped is None else term.clipped[0]
        saturation, contrast = objective.edits(parts)[0, 0].tolist()
        return FrameLight(
            time_s=time_s,
            params=parts.light[0],
            environment=environment,
            sun_direction=lamps[0].direction if lamps else brightest,
            azimuth_spread_rad=spread,
            exposure=exposure,
            white_balance=objective.white_balance(parts)[0, 0],
            edit=Edit(saturation=saturation, contrast=contrast, pivot=face.mean),
            residual=residual(shading, term.target[0], clipped),
            lamps=lamps,
        )

    def _changes(self) -> Iterator[Float[Tensor, "m q"]]:
        """Derivatives of each keyframe's deviations, with those of the light at the mean light.

        A decoder's derivatives take three times as long as all the rest of a keyframe's, and hardly
        differ over a film.
        """
        light, camera, _, ground = self.objectives[0].sizes
        parts = (light, camera, self.free.shape[1] - light - camera - ground, ground)
        first = 0
        for group in self.groups:
            count = len(group.faces)
            own = self.free[first : first + count].split(parts, 1)
            mean = self.free.mean(0).split(parts)
            free = torch.cat([mean[0], own[1].flatten(), own[2].flatten(), mean[3]])
            whole = jacobian(group, free[None])[0]
            columns = torch.arange(len(free)).split(group.sizes)
            cameras, skins = columns[1].view(count, -1), columns[2].view(count, -1)
            rows = whole.split([face.target[0].numel() for face in group.faces])
            for k, block in enumerate(rows):
                yield block[:, torch.cat([columns[0], cameras[k], skins[k], columns[3]])]
            first += count

    def _shape(self, k: int, change: Float[Tensor, "m q"]) -> "_Shape":
        """Slope and Hessian of a keyframe in what is shared, its own unknowns at their best.

        The Hessian is that of :func:`skylight.inverse._least_squares.laplace`.
        """
        objective, free = self.objectives[k], self.free[k, None]
        gaps = deviations(objective, free)
        weights = objective.deviation_weights(gaps)
        change = change.double()
        slope = change.T @ (weights * gaps / charbonnier(gaps))[0].double()
        hessian = change.T @ (change * curvatures(gaps, weights)[0].double()[:, None])

        def prior(x: Tensor, rows: Tensor) -> Tensor:
            return _priors(objective, x, shared=False)

        own_slope, own_hessian = convex_shape(prior, free, torch.zeros(1, dtype=torch.long))
        slope = (slope + own_slope[0].double()).numpy()
        hessian = (hessian + own_hessian[0].double()).numpy()
        solved = np.linalg.solve(
            hessian[np.ix_(self.own, self.own)],
            np.column_stack([hessian[np.ix_(self.own, self.shared)], slope[self.own]]),
        )
        across = hessian[np.ix_(self.shared, self.own)]
        return _Shape(
            slope=slope[self.shared] - across @ solved[:, -1],
            hessian=hessian[np.ix_(self.shared, self.shared)] - across @ solved[:, :-1],
            own_slope=solved[:, -1],
            own_by_shared=solved[:, :-1],
        )

    def _drifting(self, at: Float[np.ndarray, " n"]) -> Drifting:
        """The priors of what is shared, as normal ones about where the first keyframe is now."""
        objective, free = self.objectives[0], self.free[0, None]

        def prior(x: Tensor, rows: Tensor) -> Tensor:
            return _priors(objective, x, shared=True)

        slope, hessian = convex_shape(prior, free, torch.zeros(1, dtype=torch.long))
        precision = hessian[0].double().numpy()[np.ix_(self.shared, self.shared)]
        scale = np.zeros(len(self.shared))
        scale[: self.lights] = 1.0
        azimuth = self.model.azimuth_index
        if azimuth is not None:
            scale[azimuth] = _TURNING
            precision[azimuth, azimuth] += 1 / _ANY_AZIMUTH
        # what priors do not bend at all is left to a wide normal one
        precision[np.diag_indices_from(precision)] += 1e-3
        covariance = covariance_of(precision)
        mean = at - covariance @ slope[0, self.shared].double().numpy()
        return Drifting(mean=mean, covariance=covariance, times_s=self.times_s, scale=scale)

    @torch.no_grad()
    def _cost(self, free: Float[Tensor, "k q"], model: Drifting) -> float:
        """What the steps lower, in nats."""
        total = 0.0
        for objective, x in zip(self.objectives, free[:, None], strict=True):
            own = float(_priors(objective, x, shared=False))
            total += (float(objective.terms(x)["data"]) + own) / self.noise
        total += float(_priors(self.objectives[0], free[:1], shared=True))
        moved = np.diff(free[:, self.shared].double().numpy(), axis=0)
        spread = model.scale * self.drift * np.diff(self.times_s)[:, None]
        drifts = spread > 0
        return total + 0.5 * float((moved[drifts] ** 2 / spread[drifts]).sum())


def _together(solver: SkySolver, frames: Sequence[LitFaces]) -> LightObjective:
    """Several keyframes under one light."""
    faces = LitFaces()
    faces.extend(_photographs(frames))
    return solver.objective([faces], [None], _FULL)


def _photographs(frames: Sequence[LitFaces]) -> list[ScannedFace]:
    """The face of each keyframe, as one photograph each."""
    return [replace(faces[0], photo=photo) for photo, faces in enumerate(frames)]


@dataclass(frozen=True, kw_only=True)
class _Shape:
    """``own_slope`` and ``own_by_shared`` tell the own unknowns' step from that of the shared."""

    slope: Float[np.ndarray, " n"]
    hessian: Float[np.ndarray, "n n"]
    own_slope: Float[np.ndarray, " o"]
    own_by_shared: Float[np.ndarray, "o n"]


def _priors(objective: LightObjective, free: Tensor, *, shared: bool) -> Float[Tensor, " b"]:
    """Those of what all keyframes share, or those of what is each one's own."""
    every = objective.priors(free).items()
    return torch.stack([nll for name, nll in every if (name in _SHARED_PRIORS) == shared]).sum(0)


def _starting(objective: LightObjective, start: Estimate) -> Float[Tensor, "1 q"]:
    """A keyframe's free parameters where it sees the light of ``start``, at its best exposure."""
    first = start.faces[0]
    ones = torch.ones(1, 1)

    def packed(exposure: Tensor) -> Float[Tensor, "1 q"]:
        return objective.pack(
            start.params[None],
            exposure,
            first.specular_scale * ones if first.specular_scale > 0 else ones,
            first.albedo[None, None],
            start.ground_albedo[None, : objective.sizes[-1]],
        )

    with torch.no_grad():
        shading = objective.shading(objective.unpack(packed(ones)))[0]
    term = objective.faces[0]
    return packed(best_exposure(term.seen(shading), term.target, term.exact_share)[None])


def in_world(observation: Observation, world_from_camera: Float[ndarray, "3 3"]) -> Observation:
    """The observation of a camera that stands in the world by that rotation.

    With B the bilinear look-up of the world's light in the directions of the camera's grid,
    l_camera = B l_world, its transport is T B: exact for light that is the same everywhere, and for
    turns about the vertical by whole columns; else light is blurred by less than a pixel.
    """
    rotation = torch.from_numpy(np.asarray(world_from_camera, dtype=np.float64))
    normal_modes = observation.normal_modes
    if normal_modes is not None:
        look_up = _look_up(normal_modes.grid, rotation)
        # T of a matrix of visible solid angles; the modes are vectors
        modes = torch.einsum("dc,mck->mdk", rotation.to(normal_modes.modes), normal_modes.modes)
        visible = _times(normal_modes.visible, look_up)
        normal_modes = replace(normal_modes, modes=modes, visible=visible)
    look_up = _look_up(observation.transport.grid, rotation)

    def moved(transport: TransportMatrix) -> TransportMatrix:
        return replace(transport, matrix=_times(transport.matrix, look_up))

    return replace(
        observation,
        transport=moved(observation.transport),
        specular=None if observation.specular is None else moved(observation.specular),
        normal_modes=normal_modes,
    )


def _times(matrix: Float[Tensor, "m n"], look_up: csr_matrix) -> Float[Tensor, "m n"]:
    return torch.from_numpy(np.ascontiguousarray((look_up.T @ matrix.numpy().T).T))


def _look_up(grid: DirectionGrid, world_from_camera: Float[Tensor, "3 3"]) -> csr_matrix:
    """B, one row for each of the camera's directions; across the poles as maps are continued."""
    assert grid.layout is not None
    height, width = grid.layout
    row, column = pixel_from_direction(grid.directions @ world_from_camera.T, height, width)
    index, weights = bilinear_taps(height, width, row, column)
    count = len(grid)
    places = np.repeat(np.arange(count), 4), index.flatten().numpy()
    return csr_matrix((weights.flatten().float().numpy(), places), shape=(count, count))
