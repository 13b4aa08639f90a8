"""Light models fitted to a known sky with the same loss and optimiser.

What steered the choices, mean MAE of the shading on 20 simulated skies and on the 21 real maps of
the development half alone (:mod:`skylight.evaluation._sky_models`), an earlier autoencoder
without a sun head, then Sun + Sky:

=====================================  ============  ============
azimuth free, no shading term           .055 / .231   .098 / .171
shading 2, azimuth held at first        .025 / .176   .045 / .083
shading 5, azimuth held at first        .020 / .147   .032 / .050
=====================================  ============  ============

(the last from four starts, which change nothing there). A shading weight of 5 betters the shading
further and costs Full-dω (real: .354 to .363, .366 to .374), to which 2 against none does less
harm than good (.393 to .354, .361 to .366). With the shipped autoencoder three more starts, from
the nearest skies of its bank, and half as many iterations again took MAE from .059 to .053 on the
real maps, for a third more time; they are left out.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.inverse._gauss_newton import charbonnier
from skylight.inverse._lbfgs import Objective, minimise
from skylight.models._ground import LambertianGround
from skylight.models._harmonic import HarmonicLight, solve_linear
from skylight.models._network import HEIGHT
from skylight.models.autoencoder import AutoencoderLight
from skylight.models.sunsky import SunSky, fit_sunsky
from skylight.skies._index import centre_column_azimuth
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid

HELD, RELEASED = 50, 30  # iterations with the azimuth held, then with all parameters
_NORMALS = 128


@dataclass(frozen=True, kw_only=True)
class LossWeights:
    """Weights of the terms of :class:`SkyLoss`.

    ``picture`` takes squares instead, and every pixel alike.
    """

    radiance: float = 1.0
    log: float = 1.0
    shading: float = 2.0
    picture: bool = False


@runtime_checkable
class Decoder(Protocol):
    """What a fit needs of a light model: see :class:`skylight.models._base.LightModel`."""

    azimuth_index: int | None

    @property
    def grid(self) -> DirectionGrid: ...

    def __call__(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "b n 3"]: ...

    def to_free(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "b p"]: ...

    def from_free(self, free: Float[Tensor, "b p"]) -> Float[Tensor, "b p"]: ...


class SkyLoss:
    """L1 of radiance, of log(1 + radiance), and of what the sky lights, each with its weight.

    The first knows the sun's energy, which the second hardly sees; the second knows the sky.
    Both are means over the hemisphere and the channels, and as L1 they are content with the
    median of what a model cannot resolve, which is darker than its mean. The third knows the
    mean: ``E(n) = sum_w L(w) <n, w>+ dw / pi`` at 128 normals n over the sphere, without shadows.
    """

    def __init__(
        self, model: Decoder, sky: Float[Tensor, "h w 3"], weights: LossWeights = LossWeights()
    ) -> None:
        self.model = model
        self.weights = weights
        self.target = sky.reshape(-1, 3)
        self.coded = torch.log1p(self.target)
        share = (model.grid.solid_angles / (3 * 2 * math.pi)).float()[:, None]
        self.share = torch.full_like(share, 1 / (3 * len(share))) if weights.picture else share
        if weights.shading:
            self.transfer = _cosines(len(sky))
            self.lit = self.transfer @ self.target

    def of_radiance(self, radiance: Float[Tensor, "b n 3"]) -> Float[Tensor, " b"]:
        w = self.weights
        measured = torch.square if w.picture else charbonnier
        error = w.radiance * measured(radiance - self.target)
        error = error + w.log * measured(torch.log1p(radiance) - self.coded)
        loss = (error * self.share).sum((1, 2))
        if w.shading == 0:
            return loss
        return loss + w.shading * charbonnier(self.transfer @ radiance - self.lit).mean((1, 2))

    def __call__(self, free: Float[Tensor, "b q"], index: Int[Tensor, " b"]) -> Float[Tensor, " b"]:
        return self.of_radiance(self.model(self.model.from_free(free)))


@cache
def _cosines(height: int) -> Float[Tensor, "m n"]:
    """<n, w>+ dw / pi of sky directions w for normals n spread over the sphere."""
    sky, normals = DirectionGrid.sky(height), DirectionGrid.hammersley(_NORMALS)
    cosine = (normals.directions @ sky.directions.T).clamp(min=0)
    return (cosine * sky.solid_angles / math.pi).float()


def fit_harmonic(
    sky: Float[Tensor, "h w 3"], ground: Float[Tensor, "3"], *, degree: int
) -> EnvironmentMap:
    """Least squares over the whole sphere, ground included, weighted by solid angle; cut at 0."""
    truth = over_ground(sky, ground)
    model = HarmonicLight(degree, truth.layout[0])
    weights = truth.grid.solid_angles
    coefficients = solve_linear(model.basis.double(), truth.flat.double(), weights)
    radiance = model(coefficients.reshape(1, -1))[0]
    return EnvironmentMap(radiance=radiance.float().reshape(*truth.layout, 3))


def fit_sun_and_sky(sky: Float[Tensor, "h w 3"], ground: Float[Tensor, "3"]) -> EnvironmentMap:
    """From the closed-form fit down under :class:`SkyLoss`."""
    fitted = descend(SkyLoss(SunSky(), sky), sun_and_sky_start(sky))
    return over_ground(fitted.reshape(sky.shape), ground)


def feed_forward(
    light: AutoencoderLight, sky: Float[Tensor, "h w 3"], ground: Float[Tensor, "3"]
) -> EnvironmentMap:
    """Encoded and decoded, nothing fitted."""
    with torch.no_grad():
        radiance = light(autoencoder_start(light, sky))[0]
    return over_ground(radiance.reshape(sky.shape), ground)


def fit_autoencoder(
    light: AutoencoderLight, sky: Float[Tensor, "h w 3"], ground: Float[Tensor, "3"]
) -> EnvironmentMap:
    """From the encoder's latents down under :class:`SkyLoss`."""
    fitted = descend(SkyLoss(light, sky), autoencoder_start(light, sky))
    return over_ground(fitted.reshape(sky.shape), ground)


Fit = Callable[[Float[Tensor, "h w 3"], Float[Tensor, "3"]], EnvironmentMap]


def fits(light: AutoencoderLight) -> dict[str, Fit]:
    """All by name; ``light`` is the autoencoder that is scored."""
    return {
        "sh9": lambda sky, ground: fit_harmonic(sky, ground, degree=2),
        "sh25": lambda sky, ground: fit_harmonic(sky, ground, degree=4),
        "sunsky": fit_sun_and_sky,
        "autoencoder_feedforward": partial(feed_forward, light),
        "autoencoder": partial(fit_autoencoder, light),
    }


def sun_and_sky_start(sky: Float[Tensor, "h w 3"]) -> Float[Tensor, "1 p"]:
    """The closed-form fit."""
    return fit_sunsky(sky.reshape(1, -1, 3), SunSky()).float()


def autoencoder_start(light: AutoencoderLight, sky: Float[Tensor, "h w 3"]) -> Float[Tensor, "1 p"]:
    """The encoder's latents, the sun ahead."""
    azimuth = torch.tensor([[centre_column_azimuth(HEIGHT)]])
    with torch.no_grad():
        return torch.cat([light.network.encode(sky[None]), azimuth], 1)


def descend(
    loss: SkyLoss, start: Float[Tensor, "1 p"], *, held: int = HELD, released: int = RELEASED
) -> Float[Tensor, "n 3"]:
    """Radiance of :func:`fitted_parameters`."""
    with torch.no_grad():
        return loss.model(fitted_parameters(loss, start, held=held, released=released))[0]


def fitted_parameters(
    loss: SkyLoss, start: Float[Tensor, "1 p"], *, held: int = HELD, released: int = RELEASED
) -> Float[Tensor, "1 p"]:
    """Those at the least loss that descent from ``start`` finds in so many iterations.

    The azimuth is held at first. A map turned by parts of a column has a kink wherever the turn
    is a whole number of columns, and at that kink, where all starts are, the one-sided gradient
    of a sharp sun can point uphill: joint descent then stops before the sky is fitted.
    """
    free = loss.model.to_free(start)
    best = minimise(_held(loss, free), free, iterations=held).x
    best = minimise(loss, best, iterations=released).x
    return loss.model.from_free(best)


def _held(loss: SkyLoss, start: Float[Tensor, "s q"]) -> Objective:
    """The loss with each problem's azimuth as it is at its start."""
    azimuth = loss.model.azimuth_index
    if azimuth is None:
        return loss
    still = torch.arange(start.shape[1]) == azimuth
    return lambda free, index: loss(torch.where(still, start[index], free), index)


def over_ground(sky: Float[Tensor, "h w 3"], albedo: Float[Tensor, "3"]) -> EnvironmentMap:
    """The full sphere: a sky above the Lambertian ground that it lights."""
    ground = LambertianGround(len(sky))(sky.reshape(1, -1, 3), albedo[None])[0]
    return EnvironmentMap(radiance=sky).with_ground(ground)
