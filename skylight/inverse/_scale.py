"""How bright is the light, how dark the skin? Priors over the scale that a picture leaves open.

Albedo and specular scale times c in light times 1/c look the same (thesis, Eq. 5.9).
"""

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.models._prior import GaussianMixture

MOST_ALBEDO = 0.95  # of skin, in any channel
DAYLIGHT_HUE = 0.2  # in the log of each channel against their mean
SCALES = 2.0 ** torch.arange(-4, 4.01, 0.125)  # of albedo against light
SPECULAR_SPREAD = 0.7  # of log specular scale: skin from dry to oily, a factor of two either way


def tone_prior(albedo_prior: GaussianMixture) -> GaussianMixture:
    """Over log albedo whose hue is as uncertain as the light's, by :data:`DAYLIGHT_HUE`.

    A skin that looks a little too red need not be the darkest. A white balance that is estimated
    with the light does not settle its hue: it tells how a photograph may differ from the light,
    this how daylight may differ from what was estimated.
    """
    grey = torch.full((3, 3), 1 / 3)
    return albedo_prior.widened(DAYLIGHT_HUE**2 * (torch.eye(3) - grey))


def scale_nll(
    albedo: Float[Tensor, "b f 3"], prior: GaussianMixture, weight: float = 1.0
) -> Float[Tensor, "s b"]:
    """-ln p of the albedos of all faces at each of :data:`SCALES`; infinite beyond what is skin.

    A scale of 1 is always possible, so that there is one.
    """
    scales = SCALES.to(albedo)
    tried = scales[:, None, None, None] * albedo
    nll = -weight * prior.log_prob(tried.log().flatten(0, 2)).unflatten(0, tried.shape[:3])
    possible = (tried < MOST_ALBEDO).flatten(2).all(2) | (scales[:, None] == 1)
    return torch.where(possible, nll.sum(2), torch.inf)


def specular_nll(
    specular_scale: Float[Tensor, "b f"], has_specular: Float[Tensor, " f"]
) -> Float[Tensor, "s b"]:
    """-ln p of all faces' specular scales at each of :data:`SCALES`, where ``has_specular``."""
    shine = (SCALES.to(specular_scale)[:, None, None] * specular_scale).log() * has_specular
    return 0.5 * (shine / SPECULAR_SPREAD).square().sum(2)


def bayes_scale(nll: Float[Tensor, "s b"]) -> Float[Tensor, " b"]:
    """Of :data:`SCALES` on albedo the one whose light has the least expected relative error.

    If c is the truth with probability p(c) = exp(-nll) and s is answered, light is off by
    ``|c/s - 1|`` of itself, and ``sum p(c) |c/s - 1|`` is least where s is the median of c under
    the weights p(c) c. Where only one tone is likely that is its own; between a dark and a light
    skin it leans to the light one, since light ten times too bright is a larger error than a tenth
    of it.
    """
    scales = SCALES.to(nll)
    weight = (-nll).softmax(0) * scales[:, None]
    return scales[(weight.cumsum(0) < 0.5 * weight.sum(0)).sum(0)]
