"""Light reflected by the ground: one Lambertian bounce of the sky, and a prior of its albedo."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from skylight.models.known_ground import KnownGround
from skylight.models.prior import GaussianMixture
from skylight.sphere.grid import row_edges_cos

# Mean linear albedos of nine grounds (thesis, Fig. B.4): light and dark concrete, asphalt, dry
# and wet dirt, grass, rocks, gravel, mulch.
GROUND_ALBEDOS = (
    (0.20, 0.17, 0.14),
    (0.14, 0.13, 0.12),
    (0.05, 0.04, 0.03),
    (0.09, 0.08, 0.06),
    (0.05, 0.04, 0.03),
    (0.09, 0.10, 0.03),
    (0.20, 0.18, 0.15),
    (0.17, 0.15, 0.13),
    (0.14, 0.10, 0.08),
)
# The nine lie close together; real grounds do not (snow, sand, paving): this much wider.
GROUND_SPREAD = 1.5


class LambertianGround(nn.Module):
    """A horizontal plane of constant albedo under an unoccluded sky of ``height`` rows.

    Thesis, eq. 5.7: ``s = rho / pi sum_w l(w) <n, w>+ dw``. The weight of a pixel is the exact
    integral of the cosine over it, ``dphi (cos^2 t_0 - cos^2 t_1) / 2``, so the weights sum to pi
    to rounding and a constant sky of 1 gives exactly rho.
    """

    transfer: Tensor

    def __init__(self, height: int = 32) -> None:
        super().__init__()
        width = 4 * height
        row = -torch.diff(row_edges_cos(height, width) ** 2) * math.pi / width
        self.register_buffer("transfer", row.repeat_interleave(width), persistent=False)

    def forward(
        self, sky: Float[Tensor, "*batch n 3"], albedo: Float[Tensor, "*#batch 3"]
    ) -> Float[Tensor, "*batch 3"]:
        """Radiance of the ground, the same in all directions."""
        irradiance = torch.einsum("n,...nc->...c", self.transfer.to(sky), sky)
        return albedo / math.pi * irradiance

    def append(
        self, sky: Float[Tensor, "*batch n 3"], albedo: Float[Tensor, "*#batch 3"]
    ) -> Float[Tensor, "*batch m 3"]:
        """The full sphere, (h,4h) sky rows above (h,4h) ground rows: m = 2 n."""
        ground = self(sky, albedo)[..., None, :].expand_as(sky)
        return torch.cat([sky, ground], dim=-2)


def ground_prior(known: KnownGround | None = None) -> GaussianMixture:
    """Density of log albedos (RGB): one Gaussian, from the moments of the nine grounds.

    Of a ground that is known, N(log albedo, spread^2) in each channel.

    One component, because nine grounds carry no more: with two, the Bayesian information
    criterion is higher. Its covariance is :data:`GROUND_SPREAD` squared times theirs, plus 0.01
    where they leave no room.
    """
    if known is not None:
        mean = torch.tensor(known.albedo).log()
        return GaussianMixture(torch.ones(1), mean[None], torch.eye(3)[None] / known.spread)
    log_albedo = torch.tensor(GROUND_ALBEDOS).log()
    covariance = torch.cov(log_albedo.T) * GROUND_SPREAD**2 + 0.01 * torch.eye(3)
    # precision = B B^T with an upper triangular B
    factor = torch.linalg.inv(torch.linalg.cholesky(covariance)).mT.contiguous()
    return GaussianMixture(torch.ones(1), log_albedo.mean(0)[None], factor.triu()[None])
