"""Light that the ground throws back up: one Lambertian bounce of the sky."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from skylight.sphere.grid import row_edges_cos


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

    def radiance(
        self, sky: Float[Tensor, "b n 3"], albedo: Float[Tensor, "b 3"]
    ) -> Float[Tensor, "b 3"]:
        """Radiance of the ground, the same in all directions."""
        irradiance = torch.einsum("n,bnc->bc", self.transfer.to(sky), sky)
        return albedo / math.pi * irradiance

    def append(
        self, sky: Float[Tensor, "b n 3"], albedo: Float[Tensor, "b 3"]
    ) -> Float[Tensor, "b m 3"]:
        """The full sphere, (h,4h) sky rows above (h,4h) ground rows: m = 2 n."""
        ground = self.radiance(sky, albedo)[:, None].expand_as(sky)
        return torch.cat([sky, ground], dim=1)
