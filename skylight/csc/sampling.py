"""Importance sampling of an environment map from its sparse code (thesis, 6.7)."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.csc.code import CodeTensors, SparseCode
from skylight.csc.coder import SphericalSparseCoder, pixel_of
from skylight.csc.correlation.positions import centres_of
from skylight.csc.gaussian_lobes import GaussianLobes, fitted_lobes
from skylight.csc.sub_dictionaries import PixelDictionary
from skylight.errors import InputError
from skylight.sphere.envmap import luminance
from skylight.sphere.frame import direction_from_angles
from skylight.sphere.grid import DirectionGrid, row_edges_cos
from skylight.sphere.rotation import matrix_from_euler

# Least share of uniform directions: of 0.02 to 0.5 the best over 32 maps at 64 activations, by 4 %
# against 0.1 (`tools/measure_code_sampling.py`).
UNIFORM = 0.2
_AT_ONCE = 2**14  # directions whose densities are evaluated together


@dataclass(frozen=True, kw_only=True)
class CodeSampler:
    """Draws directions with a density close to the luminance of a sparse code::

        pdf(w) = s_0 / (4 pi) + sum_j s_j f_j(w) + sum_i s_i [w in pixel i] / solid angle_i

    with ``shares`` s that sum to 1. f_0 = 1 / (4 pi) and the f_j are :class:`GaussianLobes`, the
    lobes of the code's filters; ``pixels`` are the activations of a fine coder that are pixels of
    a lat-long map of ``height`` rows. Everything is drawn exactly, so ``mean(g / pdf)`` is an
    unbiased estimate of any integral of g over the sphere. Which pixel a direction is in is told in
    double precision; where g is a map it should be looked up so too, or border samples of a sun
    differ. ``pdf`` is differentiable in the directions and in the weights and rotations of
    :meth:`of`.

    A share is the power of its activation, luminance of the weight times the integral of the
    filter. Two things of the decoded map are not in the density: activations of negative
    luminance, which have no share, and what the band limit does to the sharpest filters, ringing
    above all. But for that the density is the decoded luminance up to a factor where no weight is
    negative and the constant has its share. It is positive everywhere through s_0, which covers
    what the code has missed of the map.
    """

    lobes: GaussianLobes
    pixels: Int[Tensor, " p"]
    height: int
    shares: Float[Tensor, " c"]

    @staticmethod
    def of(
        code: SparseCode | CodeTensors,
        coder: SphericalSparseCoder,
        *,
        uniform: float = UNIFORM,
        dtype: torch.dtype = torch.float32,
    ) -> "CodeSampler":
        """The sampler of one code that ``coder`` can decode.

        Parameters
        ----------
        uniform
            The least share s_0 of uniform directions, above 0 and at most 1. The share is that of
            the code's constant where that is larger.

        Raises
        ------
        InputError
            The code is another coder's or a batch, no weight has a positive luminance, or
            ``uniform`` is out of range.
        """
        if not 0 < uniform <= 1:
            raise InputError(f"a share {uniform} of uniform directions: choose one in (0, 1]")
        if isinstance(code, SparseCode):
            coder.check(code)
            code = code.tensors().to(coder.bank.unnormalised.device)
        if code.filters.ndim != 1:
            raise InputError("a sampler is of one code: give one of the batch")
        used = code.used
        filters, rotations = code.filters[used], code.rotations[used].double()
        pixel = pixel_of(centres_of(rotations), (coder.height, 2 * coder.height))
        shapes = _Shapes.of(coder, filters, pixel)
        power = luminance(code.weights[used].double()).clamp(min=0) * shapes.integrals
        total = power.sum()
        if not float(total.detach()) > 0:
            raise InputError("the code has no activation of positive luminance: code another map")
        even = ~shapes.are_pixels & (shapes.precisions[:, 1] == 0)
        share = (power[even].sum() / total).clamp(min=uniform)
        rest = power[~even].sum()
        power = power * (1 - share) / torch.where(rest > 0, rest, 1.0)
        round_ = ~even & ~shapes.are_pixels
        alpha, beta, gamma = rotations[round_].unbind(1)
        turned = matrix_from_euler(alpha, beta, gamma + shapes.longitudes[round_])
        # about the zenith: (z, x, y) takes the place of (x, y, z)
        axes = turned[:, [1, 2, 0]].permute(2, 0, 1)
        precisions = shapes.precisions[round_]
        lobes = GaussianLobes(  # the first is uniform
            axes=torch.cat([torch.eye(3).to(axes)[:, None], axes], 1).to(dtype),
            precisions=torch.cat([precisions.new_zeros(1, 2), precisions]).to(dtype),
        )
        shares = torch.cat([share[None], power[round_], power[shapes.are_pixels]])
        return CodeSampler(
            lobes=lobes,
            pixels=pixel[shapes.are_pixels],
            height=coder.height,
            shares=shares.to(dtype),
        )

    def pdf(self, directions: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """The density in unit directions, per steradian."""
        return torch.cat([self._pdf(some) for some in directions.split(_AT_ONCE)])

    def _pdf(self, directions: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        lobes = self.lobes.density(directions.to(self.shares)) @ self.shares[: self._lobes]
        if not len(self.pixels):
            return lobes
        # a sun that single precision puts beyond the border of its pixel would be a rare bright
        # sample: on one map it made integrals 1 % too large
        within = pixel_of(directions.double(), self._layout)[:, None] == self.pixels
        angles = DirectionGrid.latlong(self.height).solid_angles.to(self.shares)[self.pixels]
        return lobes + within.to(lobes) @ (self.shares[self._lobes :] / angles)

    @torch.no_grad()
    def sample(
        self, count: int, generator: torch.Generator | None = None
    ) -> Float[Tensor, "count 3"]:
        """``count`` independent unit directions of density :meth:`pdf`."""
        which = torch.multinomial(self.shares, count, replacement=True, generator=generator)
        out = self.shares.new_empty(count, 3)
        (round_,) = torch.nonzero(which < self._lobes, as_tuple=True)
        out[round_] = self.lobes.draw(which[round_], generator)
        (dots,) = torch.nonzero(which >= self._lobes, as_tuple=True)
        out[dots] = self._within_pixels(self.pixels[which[dots] - self._lobes], generator)
        return out

    def towards(self, normal: Float[Tensor, "3"]) -> "CodeSampler":
        """The sampler for the irradiance of a surface of unit ``normal``.

        Shares are multiplied by the mean of ``max(<n, w>, 0)`` under each lobe, as if ``<n, w>``
        were normally distributed with its mean m and standard deviation s there:
        ``m Phi(m / s) + s phi(m / s)``. The density stays exact and positive.
        """
        normal = normal.to(self.shares)
        mean, variance = self.lobes.moments()
        along = self.lobes.axes @ normal  # (3, k)
        centre = mean * along[2]
        spread = (variance.mT * along.square()).sum(0).clamp(min=1e-12).sqrt()
        ratio = centre / spread
        bell = torch.exp(-0.5 * ratio.square()) / math.sqrt(2 * math.pi)
        lobes = centre * torch.special.ndtr(ratio) + spread * bell
        dots = DirectionGrid.latlong(self.height).directions.to(normal)[self.pixels] @ normal
        shares = self.shares * torch.cat([lobes.clamp(min=0), dots.clamp(min=0)])
        return replace(self, shares=shares / shares.sum())

    @property
    def _lobes(self) -> int:
        return len(self.lobes.precisions)

    @property
    def _layout(self) -> tuple[int, int]:
        return self.height, 2 * self.height

    def _within_pixels(
        self, pixels: Int[Tensor, " n"], generator: torch.Generator | None
    ) -> Float[Tensor, "n 3"]:
        """Uniform directions in pixels of the map."""
        height, width = self._layout
        edges = row_edges_cos(height, width).to(self.shares)
        row, column = pixels // width, pixels % width
        down, along = torch.rand(
            2, len(pixels), generator=generator, dtype=edges.dtype, device=edges.device
        )
        zenith = torch.acos(torch.lerp(edges[row], edges[row + 1], down))
        return direction_from_angles(2 * math.pi * ((column + along) / width - 0.5), zenith)


class _Shapes(NamedTuple):
    """What lobes activations have: which are pixels, and the Gaussians of the others.

    ``integrals`` are those of the filters over the sphere, 0 where they are negative.
    """

    are_pixels: Bool[Tensor, " s"]
    precisions: Float[Tensor, "s 2"]
    longitudes: Float[Tensor, " s"]
    integrals: Float[Tensor, " s"]

    @staticmethod
    def of(
        coder: SphericalSparseCoder, filters: Int[Tensor, " s"], pixel: Int[Tensor, " s"]
    ) -> "_Shapes":
        blank = torch.zeros(len(filters), dtype=torch.float64, device=filters.device)
        are_pixels, integrals = torch.zeros_like(filters, dtype=torch.bool), blank.clone()
        precisions, longitudes = blank[:, None].repeat(1, 2), blank.clone()
        angles = DirectionGrid.latlong(coder.height).solid_angles.to(blank)
        for part in coder.parts:
            mine = (filters >= part.first) & (filters < part.first + part.count)
            if isinstance(part, PixelDictionary):
                are_pixels = mine
                integrals[mine] = angles[pixel[mine]].sqrt()
            else:
                own = filters[mine] - part.first
                precisions[mine], longitudes[mine] = fitted_lobes(part.bank, own)
                # Y_00 = 1 / sqrt(4 pi)
                mean = part.bank.coefficients.detach()[own, 0].to(blank)
                integrals[mine] = (math.sqrt(4 * math.pi) * mean).clamp(min=0)
        return _Shapes(are_pixels, precisions, longitudes, integrals)
