"""Ablation: the autoencoder with the true albedo, or started at its fit to the true sky.

(The third answer, true geometry, is a matter of which head the transport is traced on.)
"""

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.evaluation.faces.known_faces import KnownFace
from skylight.evaluation.skies.sky_fits import (
    HELD,
    RELEASED,
    SkyLoss,
    autoencoder_start,
    fitted_parameters,
)
from skylight.faces.skin import SkinPrior
from skylight.inverse.estimate import albedo_prior, smooth_autoencoder
from skylight.inverse.result import Estimate
from skylight.inverse.sky.problem import SkyProblem
from skylight.models.autoencoder import AutoencoderLight
from skylight.models.bundle import load_bundle
from skylight.models.networks.base import CENTRE_AZIMUTH_RAD
from skylight.models.prior import GaussianMixture
from skylight.skies.loading import normalise
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.frame import angles_from_direction
from skylight.sphere.grid import DirectionGrid
from skylight.transport.observation import Observation

KNOWN_WITHIN = 0.01  # standard deviation of log albedo once it is known


def with_true_albedo(observation: Observation, face: KnownFace) -> Estimate:
    """The albedo prior replaced by one of 1 % about the skin's own albedo."""
    known = GaussianMixture(
        weights=torch.ones(1),
        means=face.albedo.log()[None],
        precision_factors=torch.eye(3)[None] / KNOWN_WITHIN,
    )
    bundle = load_bundle()
    problem = SkyProblem(smooth_autoencoder(bundle), bundle.prior(), known, face.albedo[None])
    problem.add(observation)
    return problem.solve()


def from_true_light(observation: Observation, face: KnownFace) -> Estimate:
    """Only one start: the parameters that fit the true sky."""
    model = OneStart(true_parameters(face.environment))
    modes = SkinPrior.load().means.float()
    problem = SkyProblem(model, load_bundle().prior(), albedo_prior(), modes)
    problem.add(observation)
    return problem.solve()


def true_parameters(
    environment: EnvironmentMap, *, held: int = HELD, released: int = RELEASED
) -> Float[Tensor, "1 p"]:
    """The autoencoder's parameters for the upper half of a 64 x 128 map, its azimuth included.

    ``held`` and ``released`` are the iterations of :func:`sky_fits.fitted_parameters`.
    """
    azimuth, _ = angles_from_direction(environment.brightest_direction())
    turn = float(azimuth) - CENTRE_AZIMUTH_RAD
    sky = environment.upper().rotate_azimuth(-turn).radiance
    ahead = normalise(sky[None])[0]
    light = load_bundle().light()
    loss = SkyLoss(light, ahead)
    start = autoencoder_start(light, ahead)
    parameters = fitted_parameters(loss, start, held=held, released=released).clone()
    parameters[:, light.azimuth_index] += turn
    return parameters


class OneStart:
    """The autoencoder with nowhere to start from but ``parameters``."""

    def __init__(
        self, parameters: Float[Tensor, "1 p"], model: AutoencoderLight | None = None
    ) -> None:
        model = model or smooth_autoencoder(load_bundle())
        self.model = model
        self.parameters = parameters
        self.name = model.name
        self.parameter_count = model.parameter_count
        self.azimuth_index = model.azimuth_index

    @property
    def grid(self) -> DirectionGrid:
        return self.model.grid

    @property
    def bounds(self) -> tuple[Float[Tensor, " p"], Float[Tensor, " p"]]:
        return self.model.bounds

    def __call__(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "b n 3"]:
        return self.model(params)

    def to_free(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "b p"]:
        return self.model.to_free(params)

    def from_free(self, free: Float[Tensor, "b p"]) -> Float[Tensor, "b p"]:
        return self.model.from_free(free)

    def starts(self) -> Float[Tensor, "s p"]:
        return self.parameters

    def starts_towards(self, directions: Float[Tensor, "d 3"]) -> Float[Tensor, "d 1 p"]:
        return self.parameters.expand(len(directions), 1, -1)

    def sun_direction(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "b 3"] | None:
        return self.model.sun_direction(params)

    def on_rows(self, height: int) -> "OneStart":
        return OneStart(self.parameters, self.model.on_rows(height))
