"""Relighting by precomputed transfer, in real time."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from skylight.probes.partitions.relight.transfer import TransferCoefficients


class Relighting(nn.Module):
    """L_c(x) = sum_i L_ic t_ic(x) (thesis, Eq. 4.16, with the probe's weights in the light).

    One product for each colour, linear in the light and so differentiable.
    """

    transfer: Tensor

    def __init__(self, coefficients: TransferCoefficients) -> None:
        super().__init__()
        # cells by receivers: the fastest layout for one light, and for few
        self.register_buffer("transfer", coefficients.values.permute(2, 1, 0).contiguous())

    def forward(self, light: Float[Tensor, "*b n 3"]) -> Float[Tensor, "*b m 3"]:
        """Radiance of every receiver from the radiance of every cell, in the light's dtype.

        A view whose colours lie apart in memory.
        """
        lights = light.to(self.transfer.dtype).reshape(-1, *light.shape[-2:])
        radiance = torch.bmm(lights.permute(2, 0, 1), self.transfer)  # (3, b, m)
        return radiance.permute(1, 2, 0).reshape(*light.shape[:-2], -1, 3).to(light.dtype)
