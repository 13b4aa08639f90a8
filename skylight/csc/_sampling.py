"""Importance sampling of an environment map from its sparse code (thesis, 6.7)."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.csc._code import CodeTensors, SparseCode
from skylight.csc._coder import SphericalSparseCoder, pixel_of
from skylight.csc._gaussian_lobes import GaussianLobes, fitted_lobes
from skylight.csc._sub_dictionaries import BoxDictionary
from skylight.errors import InputError
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import DirectionGrid, direction_from_angles, row_edges_cos
from skylight.sphere._rotation import matrix_from_euler

# Least share of uniform directions: of 0.02 to 0.5 the best over 32 maps at 64 activations, by 4 %
# against 0.1.
UNIFORM = 0.2
_AT_ONCE = 2**14  # directions whose densities are evaluated together


@dataclass(frozen=True, kw_only=True)
class CodeSampler:
    """Draws directions with a density close to the luminance of a sparse code::

        pdf(w) = s_0 / (4 pi) + sum_j s_j f_j(w) + sum_i s_i [w in box i] / solid angle_i

    with ``shares`` s that sum to 1. f_0 = 1 / (4 pi) and the f_j are :class:`GaussianLobes`, the
    lobes of the code's filters; ``boxes`` (first row, rows, first column, columns) are the
    activations that are boxes of pixels of a lat-long map of ``height`` rows. Everything is drawn
    exactly, so ``mean(g / pdf)`` is an unbiased estimate of any integral of g over the sphere.
    Which box a direction is in is decided in double precision; where g is a map it should be
    looked up so too, or border samples of a sun differ. ``pdf`` is differentiable in the
    directions and in the weights and rotations of :meth:`of`.

    A share is the power of its activation, luminance of the weight times the integral of the
    filter. Two things of the decoded map are not in the density: activations of negative
    luminance, which have no share, and what the band limit does to the sharpest filters, ringing
    above all. But for that the density is the decoded luminance up to a factor where no weight is
    negative and the constant has its share. It is positive everywhere through s_0, which covers
    what the code has missed of the map.
    """

    lobes: GaussianLobes
    boxes: Int[Tensor, "p 4"]
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
        shapes = _Shapes.of(coder, filters, rotations)
        power = luminance(code.weights[used].double()).clamp(min=0) * shapes.integrals
        total = power.sum()
        if not float(total.detach()) > 0:
            raise InputError("the code has no activation of positive luminance: code another map")
        even = ~shapes.are_boxes & (shapes.precisions[:, 1] == 0)
        share = (power[even].sum() / total).clamp(min=uniform)
        rest = power[~even].sum()
        power = power * (1 - share) / torch.where(rest > 0, rest, 1.0)
        round_ = ~even & ~shapes.are_boxes
        alpha, beta, gamma = rotations[round_].unbind(1)
        turned = matrix_from_euler(alpha, beta, gamma + shapes.longitudes[round_])
        # about the zenith: (z, x, y) takes the place of (x, y, z)
        axes = turned[:, [1, 2, 0]].permute(2, 0, 1)
        precisions = shapes.precisions[round_]
        lobes = GaussianLobes(  # the first is uniform
            axes=torch.cat([torch.eye(3).to(axes)[:, None], axes], 1).to(dtype),
            precisions=torch.cat([precisions.new_zeros(1, 2), precisions]).to(dtype),
        )
        shares = torch.cat([share[None], power[round_], power[shapes.are_boxes]])
        return CodeSampler(
            lobes=lobes,
            boxes=shapes.boxes.to(torch.int16),  # a sampler is kept in place of a table
            height=coder.height,
            shares=shares.to(dtype),
        )

    def pdf(self, directions: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """The density in unit directions, per steradian."""
        return torch.cat([self._pdf(some) for some in directions.split(_AT_ONCE)])

    def _pdf(self, directions: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        lobes = self.lobes.density(directions.to(self.shares)) @ self.shares[: self._lobes]
        if not len(self.boxes):
            return lobes
        # a sun that single precision puts beyond the border of its pixel would be a rare bright
        # sample: on one map it made integrals 1 % too large
        within = self._within(pixel_of(directions.double(), self._layout))
        angles = _solid_angles(self.boxes, self.height).to(self.shares)
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
        out[dots] = self._in_boxes(self.boxes[which[dots] - self._lobes], generator)
        return out

    def towards(self, normal: Float[Tensor, "3"]) -> "CodeSampler":
        """The sampler for the irradiance of a surface of unit ``normal``.

        Shares are multiplied by the mean of ``max(<n, w>, 0)`` over a box's pixels, and under each
        lobe, as if ``<n, w>`` were normally distributed with its mean m and standard deviation s:
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
        grid = DirectionGrid.latlong(self.height)
        cosine = grid.solid_angles.to(normal) * (grid.directions.to(normal) @ normal).clamp(min=0)
        pixel = torch.arange(len(grid), device=self.boxes.device)
        boxes = cosine @ self._within(pixel).to(normal)
        boxes = boxes / _solid_angles(self.boxes, self.height).to(normal)
        shares = self.shares * torch.cat([lobes.clamp(min=0), boxes])
        return replace(self, shares=shares / shares.sum())

    @property
    def _lobes(self) -> int:
        return len(self.lobes.precisions)

    @property
    def _layout(self) -> tuple[int, int]:
        return self.height, 2 * self.height

    def _within(self, pixels: Int[Tensor, " n"]) -> Bool[Tensor, "n p"]:
        """Which boxes each pixel of the map is in."""
        width = self._layout[1]
        top, rows, left, columns = self.boxes.unbind(1)
        row, column = pixels[:, None] // width - top, (pixels[:, None] - left) % width
        return (row >= 0) & (row < rows) & (column < columns)

    def _in_boxes(
        self, boxes: Int[Tensor, "n 4"], generator: torch.Generator | None
    ) -> Float[Tensor, "n 3"]:
        """Uniform directions in boxes of the map's pixels."""
        height, width = self._layout
        edges = row_edges_cos(height, width).to(self.shares)
        top, rows, left, columns = boxes.long().unbind(1)
        down, along = torch.rand(
            2, len(boxes), generator=generator, dtype=edges.dtype, device=edges.device
        )
        zenith = torch.acos(torch.lerp(edges[top], edges[top + rows], down))
        return direction_from_angles(2 * math.pi * ((left + columns * along) / width - 0.5), zenith)


def _solid_angles(boxes: Int[Tensor, "p 4"], height: int) -> Float[Tensor, " p"]:
    top, rows, _, columns = boxes.long().unbind(1)
    edges = row_edges_cos(height, 2 * height).to(boxes.device)
    return (edges[top] - edges[top + rows]) * columns * (math.pi / height)


class _Shapes(NamedTuple):
    """What activations are: which are boxes, those, and the Gaussians of the others.

    ``integrals`` are those of the filters over the sphere, 0 where they are negative.
    """

    are_boxes: Bool[Tensor, " s"]
    boxes: Int[Tensor, "p 4"]
    precisions: Float[Tensor, "s 2"]
    longitudes: Float[Tensor, " s"]
    integrals: Float[Tensor, " s"]

    @staticmethod
    def of(
        coder: SphericalSparseCoder, filters: Int[Tensor, " s"], rotations: Float[Tensor, "s 3"]
    ) -> "_Shapes":
        blank = torch.zeros(len(filters), dtype=torch.float64, device=filters.device)
        are_boxes, integrals = torch.zeros_like(filters, dtype=torch.bool), blank.clone()
        boxes = filters.new_zeros(0, 4)
        precisions, longitudes = blank[:, None].repeat(1, 2), blank.clone()
        for part in coder.parts:
            mine = (filters >= part.first) & (filters < part.first + part.count)
            if isinstance(part, BoxDictionary):
                are_boxes, boxes = mine, part.spans(filters[mine], rotations[mine])
                integrals[mine] = _solid_angles(boxes, coder.height).sqrt()
            else:
                own = filters[mine] - part.first
                precisions[mine], longitudes[mine] = fitted_lobes(part.bank, own)
                # Y_00 = 1 / sqrt(4 pi)
                mean = part.bank.coefficients.detach()[own, 0].to(blank)
                integrals[mine] = (math.sqrt(4 * math.pi) * mean).clamp(min=0)
        return _Shapes(are_boxes, boxes, precisions, longitudes, integrals)
