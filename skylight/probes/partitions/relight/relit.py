"""Relighting by precomputed transfer, in real time."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from skylight.probes.partitions.relight.transfer import TransferCoefficients
from skylight.probes.partitions.relight.turning import TurningCoefficients


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


class TurningRelighting(nn.Module):
    """L_c(x, a) = sum_i L_ic t_ic(x, a) of what is turned by any angle a, rad.

    Coefficients between the K angles are those of a periodic cubic spline through them::

        t(x, a) = sum_k beta(K a / 2 pi - k) c_k(x),    beta the cubic B-spline

    whose four summands that are not 0 cost four times a :class:`Relighting`. Exact at the K angles;
    linear in the light, differentiable in light and angle. 12 K n bytes for each receiver.

    Half way between the angles, radiance of a cow of 50 mm by 14 cells in eight captured maps is
    off from what is traced there, by root mean square over the mean (in the worst map), by::

        K              6            8            12           16           24           48
        cow       2.7 (4.8) %  1.4 (2.4) %  1.0 (1.5) %  0.8 (1.2) %  0.7 (1.0) %  0.5 (0.7) %
        ground    1.1 (2.1) %  0.6 (1.2) %  0.5 (0.9) %  0.4 (0.8) %  0.4 (0.7) %  0.2 (0.5) %

    (``tools.measure_turning``; of the ground, over what it has without the cow). The noise of the
    256 traced rays, which moves from cell to cell with the angle, is a part of it.
    """

    spline: Tensor

    def __init__(self, coefficients: TurningCoefficients) -> None:
        super().__init__()
        values = coefficients.values
        knots = _spline_coefficients(len(values)).to(values) @ values.flatten(1)
        self.register_buffer(
            "spline", knots.reshape(values.shape).permute(0, 3, 2, 1).contiguous()
        )  # angles, colours, cells, receivers

    def forward(
        self, light: Float[Tensor, "*b n 3"], angle_rad: float | Float[Tensor, ""]
    ) -> Float[Tensor, "*b m 3"]:
        """Radiance of every receiver, as :meth:`Relighting.forward`, all lights at one angle.

        Between the angles it may be below 0, by as much as the spline is off.
        """
        count = len(self.spline)
        place = torch.as_tensor(angle_rad, dtype=torch.float64) / (2 * math.pi) * count
        below = place.detach().floor()
        weights = _b_spline(place - below).to(self.spline)
        first = int(below) % count
        lights = light.to(self.spline.dtype).reshape(-1, *light.shape[-2:]).permute(2, 0, 1)
        radiance = torch.bmm(weights[0] * lights, self.spline[(first - 1) % count])  # (3, b, m)
        for j in (1, 2, 3):
            knot = self.spline[(first - 1 + j) % count]
            radiance = torch.baddbmm(radiance, weights[j] * lights, knot)
        return radiance.permute(1, 2, 0).reshape(*light.shape[:-2], -1, 3).to(light.dtype)


def _b_spline(u: Float[Tensor, ""]) -> Float[Tensor, "4"]:
    """beta of the knots before, at, after, and two after a place that is u beyond a knot."""
    v = 1 - u
    return torch.stack([v**3, 4 - 6 * u**2 + 3 * u**3, 4 - 6 * v**2 + 3 * v**3, u**3]) / 6


def _spline_coefficients(count: int) -> Float[Tensor, "k k"]:
    """From values at K periodic knots to the coefficients of the spline through them."""
    one = torch.eye(count, dtype=torch.float64)
    return torch.linalg.inv((one.roll(1, 0) + 4 * one + one.roll(-1, 0)) / 6)
