"""Densities on the sphere: anisotropic Gaussians by stereographic projection, and draws from them.

The lobes of :func:`skylight.sphere._lobes.anisotropic_gaussian` divided by their integrals. In the
plane coordinates ``(u, v) = tan(theta / 2) (cos phi, sin phi)`` of a lobe's own frame, with its
precisions ``(p, q) = (4 a1^2, 4 a2^2)``::

    f = exp(-(p u^2 + q v^2)) / Z,   dw = 4 du dv / (1 + u^2 + v^2)^2
    Z = 4 pi int_0^inf t e^-t / sqrt((p + t) (q + t)) dt

(The Jacobian is ``int t e^(-t (1 + u^2 + v^2)) dt``, and under that integral the plane's is that of
a Gaussian.) ``p = q = 0`` is the uniform density.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight._modes import Derived
from skylight.csc._dictionary import FilterBank
from skylight.sphere._frame import cosines

_LONGEST = 400.0  # the largest ratio of precisions that is fitted: lobes 20 times as long as wide


@dataclass(frozen=True, kw_only=True)
class GaussianLobes:
    """k lobes: ``axes`` (3,k,3), world directions of their u, v and centre; precisions (k,2)."""

    axes: Float[Tensor, "3 k 3"]
    precisions: Float[Tensor, "k 2"]

    @cached_property
    def _normaliser(self) -> Derived[Tensor]:
        return Derived()

    @property
    def normaliser(self) -> Float[Tensor, " k"]:
        """Z, the integrals of ``exp(-(p u^2 + q v^2))`` over the sphere, in steradians."""
        return self._normaliser.of([self.precisions], lambda: 4 * self._integral(2))

    def _integral(self, power: int, *, squared: Literal[0, 1] | None = None) -> Tensor:
        """``int exp(-(p u^2 + q v^2)) / (1 + u^2 + v^2)^power du dv``; times u^2 or v^2.

        ``pi / (power - 1)! int t^(power - 1) e^-t / sqrt((p + t) (q + t)) dt``, by the trapezoid
        rule in log t: it is exact to rounding, as the integrand is analytic and dies out.
        """
        log_t = torch.arange(-40, 5, 0.125, dtype=torch.float64, device=self.precisions.device)
        t = torch.exp(log_t)[:, None]
        p, q = self.precisions.double().unbind(1)
        values = t**power * torch.exp(-t) / torch.sqrt((p + t) * (q + t))
        if squared is not None:
            values = values / (2 * ((p, q)[squared] + t))
        total = math.pi * 0.125 / math.factorial(power - 1) * values.sum(0)
        return total.to(self.precisions)

    def density(self, directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n k"]:
        """f of every lobe, 1/sr."""
        x, y, z = (cosines(directions, axes) for axes in self.axes)
        p, q = self.precisions.unbind(1)
        # (u, v) = (x, y) / (1 + z); nothing but the uniform density reaches the antipode
        reach = (1 + z).clamp(min=torch.finfo(z.dtype).tiny ** 0.25).square()
        return torch.exp(-(p * x * x + q * y * y) / reach) / self.normaliser

    def moments(self) -> tuple[Float[Tensor, " k"], Float[Tensor, "k 3"]]:
        """Mean of the component along the centre, and the variances along u, v and the centre."""
        plane = self.normaliser / 4
        mean = 2 * self._integral(3) / plane - 1  # z = 2 / (1 + u^2 + v^2) - 1
        # x = 2 u / (1 + u^2 + v^2)
        along_u = 4 * self._integral(4, squared=0) / plane
        along_v = 4 * self._integral(4, squared=1) / plane
        rest = (1 - along_u - along_v - mean.square()).clamp(min=0)
        return mean, torch.stack([along_u, along_v, rest], 1)

    def draw(
        self, which: Int[Tensor, " n"], generator: torch.Generator | None = None
    ) -> Float[Tensor, "n 3"]:
        """A direction from each of the lobes ``which``, by exact rejection.

        Lobes of ``p q >= 1`` are proposed as plane Gaussians of variances 1 / (2 p) and 1 / (2 q)
        and accepted with the Jacobian ``(1 + u^2 + v^2)^-2``, a share ``Z sqrt(p q) / (4 pi)`` of
        them. Wider ones are proposed uniformly and accepted with ``exp(-(p u^2 + q v^2))``, a share
        ``Z / (4 pi)``. For round lobes and those of p >= 1, which all hand-made filters are, that
        is 0.40 (p = q = 1) or more, 0.99 at p = q = 200; for the longest that are fitted, 0.19.
        """
        out = self.axes.new_empty(len(which), 3)
        kind: Any = {"generator": generator, "dtype": out.dtype, "device": out.device}
        todo = torch.arange(len(which), device=which.device)
        while len(todo):
            lobe = which[todo]
            precision = self.precisions[lobe]
            normal = torch.randn(len(todo), 3, **kind)
            wide = precision.prod(1) < 1
            even = normal / normal.norm(dim=1, keepdim=True)
            plane = torch.where(
                wide[:, None],
                even[:, :2] / (1 + even[:, 2:]),
                normal[:, :2] / (2 * precision).sqrt(),
            )
            square = plane.square()
            distance = square.sum(1)
            chance = torch.where(
                wide, torch.exp(-(precision * square).sum(1)), (1 + distance).pow(-2)
            )
            taken = torch.rand(len(todo), **kind) < chance
            local = torch.cat([2 * plane, 1 - distance[:, None]], 1) / (1 + distance[:, None])
            world = torch.einsum("na,anc->nc", local[taken], self.axes[:, lobe[taken]])
            out[todo[taken]] = world / world.norm(dim=1, keepdim=True)
            todo = todo[~taken]
        return out


def fitted_lobes(
    bank: FilterBank, filters: Int[Tensor, " s"]
) -> tuple[Float[Tensor, "s 2"], Float[Tensor, " s"]]:
    """Precisions (p, q), p <= q, of the Gaussians nearest to filters, and the longitudes of u.

    They meet the filter where it has fallen to half of its height at the pole, along 16 meridians:
    ``ln(d(0) / d) / tan^2(theta / 2) = p cos^2 phi' + q sin^2 phi'``, by least squares. For the
    Gaussians of the hand-made dictionaries that is what they were made of, a little wider where
    the band limit makes them so; for a von Mises-Fisher lobe of kappa = 80 the error is 0.4 % of
    its height at most. Filters that nowhere fall to half, as the constant, or that are not positive
    at the pole get the uniform density, p = q = 0.
    """
    theta = torch.linspace(0, math.pi, 721, dtype=torch.float64)[:-1]
    phi = torch.arange(16, dtype=torch.float64) * (2 * math.pi / 16)
    kinds, kind = filters.cpu().unique(return_inverse=True)
    values = bank.polar_values(kinds, theta, phi)
    height = values[:, :1]
    below = values < 0.5 * height
    first = below.int().argmax(1, keepdim=True)
    ratio = (values.gather(1, first) / height)[:, 0].clamp(min=0.05)
    precision = -torch.log(ratio) / torch.tan(theta[first[:, 0]] / 2).square()
    mean = precision.mean(1)
    cosine = 2 * (precision * torch.cos(2 * phi)).mean(1)
    sine = 2 * (precision * torch.sin(2 * phi)).mean(1)
    spread = torch.hypot(cosine, sine)
    spread = torch.minimum(spread, mean * (_LONGEST - 1) / (_LONGEST + 1))
    peaked = (below.any(1).all(1) & (height[:, 0] > 0).all(1))[:, None]
    found = torch.where(peaked, torch.stack([mean - spread, mean + spread], 1), 0.0)
    longitude = torch.where(peaked[:, 0], (torch.atan2(sine, cosine) + math.pi) / 2, 0.0)
    return found[kind].to(filters.device), longitude[kind].to(filters.device)
