"""Lobes about the pole: height 1 at theta = 0, falling to the antipode at theta = pi.

``theta`` is the angle from the pole and ``phi`` the longitude, both in radians. Everything
broadcasts: parameters of shape (b, 1, 1) with theta (t, 1) and phi (p,) give (b, t, p).
"""

import torch
from jaxtyping import Float
from torch import Tensor


def von_mises_fisher(
    theta_rad: Float[Tensor, "*#s"], kappa: Float[Tensor, "*#s"]
) -> Float[Tensor, "..."]:
    """exp(kappa (cos theta - 1)): the von Mises-Fisher density, scaled; a spherical Gaussian."""
    # cos theta - 1 without cancellation near the pole
    return torch.exp(-2 * kappa * torch.sin(theta_rad / 2) ** 2)


def gaussian(theta_rad: Float[Tensor, "*#s"], a: Float[Tensor, "*#s"]) -> Float[Tensor, "..."]:
    """exp(-4 a^2 tan^2(theta / 2)): a plane Gaussian put on the sphere by stereographic projection.

    Tosic, Frossard, Vandergheynst 2006. Near the pole exp(-a^2 theta^2), of standard deviation
    1 / (sqrt(2) a) rad; 0 at the antipode unless a = 0, which is the constant 1.
    """
    # tan of the nearest double to pi / 2 is 1.6e16: finite, so the limit needs no branch
    return torch.exp(-4 * (a * torch.tan(theta_rad / 2)) ** 2)


def anisotropic_gaussian(
    theta_rad: Float[Tensor, "*#s"],
    phi_rad: Float[Tensor, "*#s"],
    a1: Float[Tensor, "*#s"],
    a2: Float[Tensor, "*#s"],
) -> Float[Tensor, "..."]:
    """exp(-4 tan^2(theta / 2) (a1^2 cos^2 phi + a2^2 sin^2 phi)); for a1 < a2 long along phi = 0.

    Tosic, Frossard, Vandergheynst 2006, eq. 13.
    """
    tangent = torch.tan(theta_rad / 2)
    along, across = a1 * tangent * torch.cos(phi_rad), a2 * tangent * torch.sin(phi_rad)
    return torch.exp(-4 * (along**2 + across**2))
