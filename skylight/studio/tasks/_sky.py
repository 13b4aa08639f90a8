"""Principal axes of the sky latents, for the sliders of the page.

The prior is a mixture over whitened latents x; the decoder takes latents z = S x + m, with the
lower triangular ``latent_scale`` S and ``latent_mean`` m of the light model. By the law of total
covariance, of the mixture with weights w_k, means mu_k and covariances C_k,

    E[x] = sum_k w_k mu_k,   cov x = sum_k w_k (C_k + mu_k mu_k^T) - E[x] E[x]^T,
    E[z] = S E[x] + m,       cov z = S cov(x) S^T,

and the components are the eigenvectors of cov z with the largest eigenvalues. The azimuth is no
latent: the decoder's sun is in the centre, and the page turns the map.
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.models._bundle import load_bundle
from skylight.models._network import HEIGHT, WIDTH
from skylight.models._prior import GaussianMixture
from skylight.models.autoencoder import AutoencoderLight
from skylight.relight._runtime import GROUND_ALBEDO
from skylight.work._progress import StageProgress

# What each does to a sky when it is raised, the others at the mean, in words for sliders: of the
# shipped decoder, whose skies at -2 and 2 standard deviations tests/studio/tasks/test_sky.py
# measures.
NAMES = (
    "Clouds over the sun",
    "Lower, redder sun",
    "Bluer sky",
    "Warmer, smoother sky",
    "Evening sun",
    "Brighter overhead",
    "More even all round",
    "Brighter right of the sun",
)


def latent_moments(
    light: AutoencoderLight, prior: GaussianMixture
) -> tuple[Float[Tensor, " z"], Float[Tensor, "z z"]]:
    """(mean, covariance) of the decoder's latents under a mixture over whitened ones."""
    weights, means = prior.weights.double(), prior.means.double()
    factors = prior.precision_factors.double()
    covariances = torch.linalg.inv(factors @ factors.mT)
    mean = weights @ means
    second = covariances + means[:, :, None] * means[:, None, :]
    covariance = torch.einsum("k,kpq->pq", weights, second) - torch.outer(mean, mean)
    scale = light.latent_scale.double()
    return scale @ mean + light.latent_mean.double(), scale @ covariance @ scale.T


def describe_sky(*, tell: StageProgress) -> dict[str, Any]:
    """The mean latent and the main components with their standard deviations.

    ``components`` (8, 64) are unit vectors among the decoder's latents, so that
    ``mean + sum_i a_i sigmas_i components_i`` with a_i from -2 to 2 are likely skies. ``shares``
    are those of the trace of the covariance, ``names`` say what they do (:data:`NAMES`). A
    component's sign is arbitrary; here its largest entry is positive.
    """
    tell("finding the main components", 0.0)
    bundle = load_bundle()
    mean, covariance = latent_moments(bundle.light(), bundle.latent_prior)
    variances, axes = torch.linalg.eigh(covariance)
    variances, axes = variances.flip(0)[: len(NAMES)], axes.flip(1).T[: len(NAMES)]
    largest = axes.gather(1, axes.abs().argmax(1, keepdim=True))
    return {
        "components": (axes * largest.sign()).tolist(),
        "sigmas": variances.sqrt().tolist(),
        "mean": mean.tolist(),
        "shares": (variances / covariance.trace()).tolist(),
        "names": NAMES,
        "ground_albedo": [GROUND_ALBEDO] * 3,
        "rows": HEIGHT,
        "columns": WIDTH,
    }
