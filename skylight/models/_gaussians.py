"""Sums of spherical Gaussians: a baseline without a prior of skies.

``l(w) = c + sum_k a_k exp(kappa_k (<d_k, w> - 1))`` (spherical Gaussians, e.g. Wang et al. 2009,
"All-Frequency Rendering of Dynamic, Spatially-Varying Reflectance").
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from skylight._modes import constant, full_precision, single
from skylight._module import Module
from skylight.errors import check_shape
from skylight.sphere._frame import (
    DirectionGrid,
    angles_from_direction,
    direction_from_angles,
    squared_chords,
)

LOBE_PARAMETERS, CONSTANT_PARAMETERS = 6, 3
# e^(-1/2) of the peak at 1 / sqrt(kappa): 81 deg .. 1.3 deg, half a pixel of 32 rows, so that no
# lobe falls between the centres of pixels
SHARPNESS_BOUNDS = (0.5, 2048.0)
_MIN_AMPLITUDE = 1e-6
_MIN_FRACTION = 1e-6
_MAX_LOG_AMPLITUDE = 40.0
_TABLE_COLUMNS = 32
_TABLE_SHARPNESS = (1.0, 4.0, 16.0, 64.0, 256.0, 1024.0)


class GaussianLobes(Module):
    """Parameters ``(..., 6 k + 3)`` to the radiance of (h, 4h) pixels of the upper hemisphere.

    Of (h, 2h) of the whole sphere where ``sphere`` is true.

    Each of the ``lobes`` has six: amplitude (3), azimuth and zenith angle of its direction in
    rad (any real numbers), sharpness. The constant's colour comes last. It has no prior.
    """

    azimuth_index: int | None = None  # each lobe has its own

    directions: Tensor

    def __init__(self, lobes: int, height: int = 32, *, sphere: bool = False) -> None:
        super().__init__()
        if lobes < 1:
            raise ValueError(f"a sum of {lobes} lobes: give 1 or more")
        self.lobes = lobes
        self.name = f"gaussians{lobes}"
        self.parameter_count = LOBE_PARAMETERS * lobes + CONSTANT_PARAMETERS
        self.grid = DirectionGrid.latlong(height) if sphere else DirectionGrid.sky(height)
        self.register_buffer("directions", self.grid.directions, persistent=False)

    def forward(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch n 3"]:
        """``c + sum_k a_k exp(kappa_k (<d_k, w> - 1))``: radiance ``(..., n, 3)``.

        Linear Rec.709, in the amplitudes' units, in the order of ``grid.directions``.
        Differentiable.
        """
        amplitude, azimuth, zenith, sharpness, constant = self._split(single(params))
        lobe = _lobe(direction_from_angles(azimuth, zenith), sharpness, self.directions)
        with full_precision(lobe):
            return torch.einsum("...kn,...kc->...nc", lobe, amplitude) + constant[..., None, :]

    def to_free(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        """log of the colours, angles as they are, logit of log sharpness within its bounds.

        Colours below 1e-6, and sharpness within 1e-6 of the range from a bound, move to there.
        """
        amplitude, azimuth, zenith, sharpness, constant = self._split(single(params))
        low, high = _log_bounds()
        fraction = ((sharpness.log() - low) / (high - low)).clamp(_MIN_FRACTION, 1 - _MIN_FRACTION)
        return self._join(
            amplitude.clamp(min=_MIN_AMPLITUDE).log(),
            azimuth,
            zenith,
            torch.logit(fraction),
            constant.clamp(min=_MIN_AMPLITUDE).log(),
        )

    def from_free(self, free: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        """Inverse of :meth:`to_free`."""
        amplitude, azimuth, zenith, sharpness, constant = self._split(single(free))
        low, high = _log_bounds()
        return self._join(
            # a line search may try anything; e^40 is as wrong as infinity but finite
            amplitude.clamp(max=_MAX_LOG_AMPLITUDE).exp(),
            azimuth,
            zenith,
            # exp(log) can miss a bound by a rounding
            (low + (high - low) * torch.sigmoid(sharpness)).exp().clamp(*SHARPNESS_BOUNDS),
            constant.clamp(max=_MAX_LOG_AMPLITUDE).exp(),
        )

    def matching_start(self, sky: Float[Tensor, "b n 3"]) -> Float[Tensor, "b p"]:
        """Lobes picked one after the other, where log(1 + radiance) lacks most.

        Matching pursuit (Mallat & Zhang 1993) over a table of lobes g, 32 directions round the
        vertical by six sharpnesses: the next has the largest ``<r, g>+ / |g|`` with the residual
        ``r = log(1 + L) - log(1 + l)``, mean over channels, products weighted by solid angle. Its
        colour lifts l to L in the lobe's mean of log(1 + radiance). The constant starts as the
        darkest tenth of the sky.
        """
        check_shape("GaussianLobes' skies", sky.shape, len(self.grid), 3)
        with full_precision(sky):  # the next lobe is the largest of many that are alike
            return self._matched(single(sky))

    def _matched(self, sky: Float[Tensor, "b n 3"]) -> Float[Tensor, "b p"]:
        directions, sharpness, table = (each.to(sky) for each in _table(self.grid.layout))
        weight = self.grid.solid_angles.to(sky)
        norm = (table**2 @ weight).sqrt()
        constant = sky.quantile(0.1, dim=1)
        fit = constant[:, None].expand_as(sky)
        chosen = []
        for _ in range(self.lobes):
            missing = torch.log1p(sky) - torch.log1p(fit)
            best = ((missing.mean(2) * weight) @ table.T / norm).argmax(1)
            lobe = table[best]
            share = lobe * weight / (lobe @ weight)[:, None]
            level = torch.einsum("bn,bnc->bc", share, torch.log1p(sky)).expm1()
            present = torch.einsum("bn,bnc->bc", share, torch.log1p(fit)).expm1()
            amplitude = (level - present).clamp(min=1e-3)
            fit = fit + lobe[..., None] * amplitude[:, None]
            azimuth, zenith = angles_from_direction(directions[best])
            chosen.append((amplitude, azimuth, zenith, sharpness[best]))
        parts = [torch.stack(part, 1) for part in zip(*chosen, strict=True)]
        return self._join(parts[0], parts[1], parts[2], parts[3], constant)

    def _split(
        self, params: Float[Tensor, "*batch p"]
    ) -> tuple[
        Float[Tensor, "*batch k 3"],
        Float[Tensor, "*batch k"],
        Float[Tensor, "*batch k"],
        Float[Tensor, "*batch k"],
        Float[Tensor, "*batch 3"],
    ]:
        names = f"RGB, azimuth, zenith angle, sharpness of {self.lobes} lobes, RGB of the constant"
        check_shape("GaussianLobes' parameters", params.shape, self.parameter_count, names=names)
        lobes = params[..., :-CONSTANT_PARAMETERS].unflatten(-1, (self.lobes, LOBE_PARAMETERS))
        azimuth, zenith, sharpness = lobes[..., 3:].unbind(-1)
        return lobes[..., :3], azimuth, zenith, sharpness, params[..., -CONSTANT_PARAMETERS:]

    def _join(
        self,
        amplitude: Float[Tensor, "*batch k 3"],
        azimuth: Float[Tensor, "*batch k"],
        zenith: Float[Tensor, "*batch k"],
        sharpness: Float[Tensor, "*batch k"],
        constant: Float[Tensor, "*batch 3"],
    ) -> Float[Tensor, "*batch p"]:
        rest = torch.stack([azimuth, zenith, sharpness], -1)
        return torch.cat([torch.cat([amplitude, rest], -1).flatten(-2), constant], -1)


def _lobe(
    direction: Float[Tensor, "*k 3"], sharpness: Float[Tensor, "*k"], at: Float[Tensor, "n 3"]
) -> Float[Tensor, "*k n"]:
    """``exp(kappa (<d, w> - 1))`` of unit vectors w: 1 at d."""
    return torch.exp(
        -0.5 * sharpness[..., None] * squared_chords(direction, at.to(direction.dtype))
    )


@constant()
def _table(
    layout: tuple[int, int] | None,
) -> tuple[Float[Tensor, "t 3"], Float[Tensor, " t"], Float[Tensor, "t n"]]:
    """Directions, sharpnesses and pixels of the lobes to choose from (25 MB at 32 rows)."""
    assert layout is not None
    rows = _TABLE_COLUMNS * layout[0] // layout[1]
    places = DirectionGrid.latlong(rows, _TABLE_COLUMNS).directions.float()
    directions = places.repeat_interleave(len(_TABLE_SHARPNESS), 0)
    sharpness = torch.tensor(_TABLE_SHARPNESS).repeat(len(places))
    at = DirectionGrid.latlong(*layout).directions
    return directions, sharpness, _lobe(directions, sharpness, at)


def _log_bounds() -> tuple[float, float]:
    low, high = SHARPNESS_BOUNDS
    return math.log(low), math.log(high)
