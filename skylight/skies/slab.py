"""Multiple scattering in a plane-parallel, non-absorbing cloud: the Eddington approximation.

Droplets scatter sharply forward. By delta scaling (Joseph, Wiscombe & Weinman 1976) a part
f = g^2 of what they scatter is treated as transmitted, the rest as scattered with the
asymmetry g' = g / (1 + g) at optical depths tau' = (1 - f) tau. All depths here are scaled ones.

With mean diffuse radiance J and net diffuse flux F (downwards), the beam E on top at the cosine
mu0, light without absorption obeys (Eddington's closure)::

    F(tau) + mu0 E e^(-tau/mu0) = C           (conservation)
    (4 pi / 3) dJ/dtau = -(1 - g') C + mu0 E e^(-tau/mu0)

with pi J + F/2 = D on top (D: irradiance from the sky above), and at the bottom
pi J - F/2 = A (all light going down) over ground of albedo A.

Against Monte Carlo photons in homogeneous slabs the transmitted flux is wrong by at most 0.14 of
the incident flux, 0.05 for suns above 30 degrees (see the tests).
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.skies.clear.scattering import henyey_greenstein

CLOUD_G = 0.85  # asymmetry of water droplets in visible light (Liou 2002, table 4.4)
FORWARD = CLOUD_G**2  # f: counts as not scattered
SCALED_G = CLOUD_G / (1 + CLOUD_G)


@dataclass(frozen=True, kw_only=True)
class SlabLight:
    """Mean diffuse radiance J and net downward diffuse flux F, per unit beam and unit sky.

    ``J = E beam_mean + D sky_mean``, and the same for the flux.
    """

    beam_mean: Float[Tensor, "*s"]
    beam_flux: Float[Tensor, "*s"]
    sky_mean: Float[Tensor, "*s"]
    sky_flux: Float[Tensor, "*s"]


def slab_light(
    above: Float[Tensor, "*s"], below: Float[Tensor, "*s"], mu0: float, albedo: float
) -> SlabLight:
    """The diffuse light at scaled depth ``above`` in a slab of depth ``above + below``."""
    total = above + below
    through = torch.exp(-total / mu0)
    here = torch.exp(-above / mu0)
    reflected = 1 - albedo
    resistance = 1 + reflected * 0.75 * (1 - SCALED_G) * total
    net_beam = reflected * mu0 * (0.5 * (1 + through) + 0.75 * mu0 * (1 - through)) / resistance
    net_sky = reflected / resistance
    # on top: pi J = D - F / 2 with F = C - mu0 E
    beam_top = (mu0 - net_beam) / 2
    sky_top = 1 - net_sky / 2
    descent = 0.75 * (1 - SCALED_G) * above
    beam = beam_top - descent * net_beam + 0.75 * mu0**2 * (1 - here)
    return SlabLight(
        beam_mean=beam / math.pi,
        beam_flux=net_beam - mu0 * here,
        sky_mean=(sky_top - descent * net_sky) / math.pi,
        sky_flux=net_sky,
    )


def two_lobes(cos_angle: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """Phase function of the scaled droplets: mean cosine 0.46 = g', integral 1 over the sphere."""
    return 0.8 * henyey_greenstein(cos_angle, 0.65) + 0.2 * henyey_greenstein(cos_angle, -0.3)
