"""The objective of inverse lighting (thesis, Eq. 5.8) as a function of free parameters."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.models.base import LightModel, Prior, without_azimuth
from skylight.models.ground import LambertianGround, ground_prior
from skylight.transport.matrix import DiffuseTransport
from skylight.transport.observation import Observation

CHARBONNIER_EPSILON = 1e-6
GLOSS_SPREAD = 0.7  # of log gloss: skin from matt to oily, a factor of two either way


@dataclass(frozen=True, kw_only=True)
class ObjectiveWeights:
    """How much the parts count. All parts are negative log-likelihoods, in nats.

    ``noise`` is the expected mean deviation of a pixel from the model, relative to the face's
    mean radiance: not sensor noise, but freckles, gloss and wrong geometry. Neighbouring pixels
    deviate together, so the pixels count as ``independent`` observations, whatever their number.
    """

    noise: float = 0.06
    independent: float = 250.0
    light_prior: float = 1.0
    albedo_prior: float = 1.0
    ground_prior: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Unpacked:
    """The physical meaning of a batch of free parameters."""

    light: Float[Tensor, "b p"]
    gloss: Float[Tensor, " b"]
    exposure: Float[Tensor, " b"]
    albedo: Float[Tensor, "b 3"]
    ground_albedo: Float[Tensor, "b 3"]


def charbonnier(x: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """sqrt(x^2 + 1e-6): smooth, convex, close to |x|."""
    return torch.sqrt(x * x + CHARBONNIER_EPSILON)


class SkyObjective:
    """Eq. 5.8 for a model of the sky over a Lambertian ground.

    Beyond the thesis, a share of surface reflection: shading is rho T l + gloss G l, with one
    unknown strength for the face (1 is what the index of refraction of skin says). On dark skin
    highlights are as bright as the diffuse part, and taken for diffuse they pull the sun aside.

    ``albedo_prior`` is a density over *log* albedo: over albedo itself it would be the same
    distribution, but its maximum would lean towards dark skin.

    Free parameters of one problem: those of the light model, then log exposure, log gloss, then
    the logits of skin and ground albedo, so that 0 < albedo < 1 always holds. The observation is
    scaled to a mean luminance of 1 beforehand (``scale``), which makes the loss's epsilon mean
    the same for every picture.
    """

    def __init__(
        self,
        observation: Observation,
        model: LightModel,
        light_prior: Prior,
        albedo_prior: Prior,
        weights: ObjectiveWeights,
    ) -> None:
        self.model = model
        self.light_prior = light_prior
        self.albedo_prior = albedo_prior
        self.weights = weights
        self.target = observation.pixels
        share = observation.weights / observation.weights.sum()
        self.share = share[:, None] / 3
        self.transport = DiffuseTransport(observation.transport)
        self.gloss = None if observation.gloss is None else DiffuseTransport(observation.gloss)
        self.ground = LambertianGround(model.grid.layout[0])  # type: ignore[index]
        self.ground_prior = ground_prior()

    @property
    def size(self) -> int:
        return self.model.parameter_count + 8

    def pack(
        self,
        light: Float[Tensor, "b p"],
        exposure: Float[Tensor, " b"],
        gloss: Float[Tensor, " b"],
        albedo: Float[Tensor, "b 3"],
        ground_albedo: Float[Tensor, "b 3"],
    ) -> Float[Tensor, "b q"]:
        return torch.cat(
            [
                self.model.to_free(light),
                exposure.log()[:, None],
                gloss.log()[:, None],
                torch.logit(albedo, eps=1e-4),
                torch.logit(ground_albedo, eps=1e-4),
            ],
            1,
        )

    def unpack(self, free: Float[Tensor, "b q"]) -> Unpacked:
        p = self.model.parameter_count
        return Unpacked(
            light=self.model.from_free(free[:, :p]),
            # beyond e^+-20 a line search has gone astray; exp must not overflow on its way back
            exposure=free[:, p].clamp(-20, 20).exp(),
            gloss=free[:, p + 1].clamp(-20, 5).exp(),
            albedo=torch.sigmoid(free[:, p + 2 : p + 5]),
            ground_albedo=torch.sigmoid(free[:, p + 5 : p + 8]),
        )

    def shading(self, parts: Unpacked) -> Float[Tensor, "b m 3"]:
        """rho T l + gloss G l with the exposure in l."""
        sky = self.model.radiance(parts.light) * parts.exposure[:, None, None]
        ground = self.ground.radiance(sky, parts.ground_albedo)
        shading = self.transport(sky, ground, parts.albedo)
        if self.gloss is None:
            return shading
        return shading + self.gloss(sky, ground, parts.gloss[:, None].expand(-1, 3))

    def terms(self, free: Float[Tensor, "b q"]) -> dict[str, Float[Tensor, " b"]]:
        """Each part of the objective, weighted; they add up to it."""
        parts = self.unpack(free)
        light = without_azimuth(self.model, free[:, : self.model.parameter_count])
        w = self.weights
        return {
            "data": data_term(self.shading(parts) - self.target, self.share, w),
            "light_prior": -w.light_prior * self.light_prior.log_prob(light),
            "albedo_prior": -w.albedo_prior * self.albedo_prior.log_prob(parts.albedo.log()),
            "ground_prior": -w.ground_prior * self.ground_prior.log_prob(parts.ground_albedo.log()),
            "gloss_prior": 0.5 * (parts.gloss.log() / GLOSS_SPREAD) ** 2,
        }

    def __call__(
        self, free: Float[Tensor, "b q"], index: Int[Tensor, " b"] | None = None
    ) -> Float[Tensor, " b"]:
        return torch.stack(list(self.terms(free).values())).sum(0)


def data_term(
    residual: Float[Tensor, "*b m 3"], share: Float[Tensor, "m 1"], weights: ObjectiveWeights
) -> Float[Tensor, "*b"]:
    """How unlikely a residual is, in nats: its mean Charbonnier over the expected deviation.

    ``share`` holds each pixel's weight over all pixels and channels; it sums to 1/3.
    """
    mean = (charbonnier(residual) * share).sum((-2, -1))
    return weights.independent / weights.noise * mean


def best_exposure(
    shading: Float[Tensor, "b m 3"], target: Float[Tensor, "m 3"], share: Float[Tensor, "m 1"]
) -> Float[Tensor, " b"]:
    """The exposure that makes the weighted mean of the shading that of the picture."""
    return ((target * share).sum() / (shading * share).sum((1, 2)).clamp(min=1e-12)).clamp(
        min=math.exp(-19), max=math.exp(19)
    )
