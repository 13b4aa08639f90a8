"""Lamps in ambient light from objects of known shape and material.

The light is that of :mod:`skylight.models._lamps`, exposed for each colour by itself: an albedo
that is taken to be white tints all light alike. With ``S`` the shading by known albedo and specular
reflection::

    f(x, e) = sum_p w_p sum_c rho((S_c(e_c l_c(x)))_p - s_pc) - log p(x),

which is the objective of faces (thesis, Eq. 5.8) without what skin, cameras and fitted heads leave
open: no albedo, specular scale, white balance or normals are estimated, and log e has a flat prior.
"""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.inverse._faces import ObjectiveWeights
from skylight.inverse._gauss_newton import minimise_robust
from skylight.inverse._lamp_sets import Pursuit
from skylight.inverse._lamps import MOST_LAMPS, Fitted, as_many_as_pay, in_pictures_units
from skylight.inverse._least_squares import hessian_at, laplace
from skylight.inverse._result import Lamp
from skylight.models._lamps import LampsLight, LampsPrior
from skylight.models._prior import convex_shape
from skylight.object._view import GRID_HEIGHT, ObjectMaterial, shading
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.transport._matrix import TransportMatrix
from skylight.transport._observation import Observation
from skylight.work._progress import Progress

# The expected mean deviation of a pixel, relative to the object's mean: a third of a face's. Set by
# hand: light on 32 rows makes 0.5 % of it. On a thing that casts shadows 10 % of smooth dirt, or
# bumps of a wrong size, make no lamp two; on a bare ball 5 % of dirt do.
NOISE = 0.02
SETS = 6  # of lamps to start from, for each number
COARSE_POINTS = 500  # numbers of lamps compete on so many at most
COARSE_STEPS, FINE_STEPS = 14, 15
TOLERANCE = 1e-5
FARTHEST = 19.0  # of a start's log exposure from 0: a colour that is black has none


@dataclass(frozen=True, kw_only=True)
class ObjectLamps:
    """The map, its lamps with the strongest first, and how likely the objects are under so many."""

    environment: EnvironmentMap
    lamps: tuple[Lamp, ...]
    log_evidence: float


@torch.no_grad()
def lamps_of_objects(
    observation: Observation,
    coarse: Observation,
    material: ObjectMaterial,
    progress: Progress | None = None,
) -> ObjectLamps:
    """No lamp in ambient light, then one more as long as that is likelier, up to three.

    Each number starts from the sets that explain the picture best
    (:class:`~skylight.inverse._lamp_sets.Pursuit`) and is fitted to the ``coarse`` observation,
    where numbers compete as for faces; the best is then fitted to all of the ``observation``.
    """
    mean = coarse.mean_luminance
    whole, few = (_Objective.of(one.scaled(1 / mean), material) for one in (observation, coarse))
    pursuit = Pursuit([_as_white(few.observation, material)])

    def fitted(count: int) -> Fitted[Tensor]:
        model = few.model(count)
        starts = few.best_of_each(model, pursuit.starts(model, SETS))
        point, evidence = few.minimum(count, starts, COARSE_STEPS)
        if progress is not None:
            progress((count + 1) / (MOST_LAMPS + 2))
        return Fitted(count=count, point=point, log_evidence=evidence)

    best = as_many_as_pay(fitted)
    point, evidence = whole.minimum(best.count, best.point, FINE_STEPS)
    params, exposure = point[0].cpu().split([point.shape[1] - 3, 3])
    light = LampsLight(best.count)
    environment, lamps = in_pictures_units(light, params, mean * exposure.exp(), rows=64)
    if progress is not None:
        progress(1.0)
    return ObjectLamps(environment=environment, lamps=lamps, log_evidence=evidence)


def thinned(observation: Observation) -> Observation:
    """Neighbouring pixels merged until :data:`COARSE_POINTS` at most are left."""
    while len(observation.pixels) > COARSE_POINTS:
        observation = observation.coarser(1)
    return observation


def _as_white(observation: Observation, material: ObjectMaterial) -> Observation:
    """Diffuse, of albedo 1: with the transport that luminance has under white light."""
    albedo = float(luminance(torch.tensor(material.albedo)))
    matrix = albedo * observation.transport.matrix
    if observation.specular is not None:
        matrix = matrix + material.share * observation.specular.matrix
    white = TransportMatrix(matrix=matrix, grid=observation.transport.grid)
    return replace(observation, transport=white, specular=None)


@dataclass(frozen=True, kw_only=True)
class _Objective:
    """f of the module's text. Points (b,q) are parameters of the light, then log e (3).

    ``weights`` (m,) are what each pixel counts in each channel, nats.
    """

    observation: Observation
    material: ObjectMaterial
    weights: Float[Tensor, " m"]

    @staticmethod
    def of(observation: Observation, material: ObjectMaterial) -> "_Objective":
        share = observation.weights / observation.weights.sum() / 3
        return _Objective(
            observation=observation,
            material=material,
            weights=ObjectiveWeights().independent / NOISE * share,
        )

    def model(self, count: int) -> LampsLight:
        return LampsLight(count, GRID_HEIGHT).to(self.weights.device)

    def shading(self, radiance: Float[Tensor, "*b n 3"]) -> Float[Tensor, "*b m 3"]:
        return shading(
            self.observation.transport, self.observation.specular, radiance, self.material
        )

    def best_of_each(
        self, model: LampsLight, starts: Float[Tensor, "s c p"]
    ) -> Float[Tensor, "s q"]:
        """The candidate of each set that explains the picture best, with the exposures for it."""
        light = starts.to(self.weights).flatten(0, 1)
        shaded, weights = self.shading(model(light)), self.weights[:, None]
        seen = (weights * self.observation.pixels).sum(0)
        exposure = seen / (weights * shaded).sum(1).clamp(min=1e-12)
        exposure = exposure.clamp(math.exp(-FARTHEST), math.exp(FARTHEST)).log()
        error = (exposure.exp()[:, None] * shaded - self.observation.pixels).abs()
        each = (weights * error).sum((1, 2)).unflatten(0, starts.shape[:2])
        points = torch.cat([light, exposure], 1).unflatten(0, starts.shape[:2])
        return points[torch.arange(len(points), device=points.device), each.argmin(1)]

    def minimum(
        self, count: int, starts: Float[Tensor, "s q"], steps: int
    ) -> tuple[Float[Tensor, "1 q"], float]:
        """The best point that steps from the starts end at, and its log evidence."""
        model, density = self.model(count), LampsPrior(count)

        def radiance(x: Float[Tensor, "b q"]) -> Float[Tensor, "b n 3"]:
            return x[:, None, -3:].exp() * model(x[:, :-3])

        def deviations(x: Tensor, _: Int[Tensor, " b"]) -> Float[Tensor, "b m"]:
            return (self.shading(radiance(x)) - self.observation.pixels).flatten(1)

        def jacobian(x: Tensor, _: Int[Tensor, " b"]) -> Float[Tensor, "b m q"]:
            of_light = x[:, None, None, -3:].exp() * model.slopes(x[:, :-3])
            of_exposures = torch.diag_embed(radiance(x)).movedim(-1, 1)
            return self.shading(torch.cat([of_light, of_exposures], 1)).flatten(2).mT

        def prior(x: Tensor, _: Int[Tensor, " b"]) -> Float[Tensor, " b"]:
            return -density.log_prob(x[:, :-3])

        weights = self.weights.repeat_interleave(3)[None]
        ends = minimise_robust(
            deviations, jacobian, weights, prior, starts, iterations=steps, tolerance=TOLERANCE
        )
        best = ends.x[ends.loss.argmin(), None]
        row = torch.zeros(1, dtype=torch.long).to(best.device)
        off = deviations(best, row)
        _, of_prior = convex_shape(prior, best, row)
        hessian = hessian_at(off, jacobian(best, row), weights, of_prior)
        return best, float(laplace(best, off, hessian, weights, prior))
