"""Smooth functions on the sphere: lobes about the pole, and cubic B-splines on the hemisphere.

Lobes have a height of 1 at theta = 0 and fall to the antipode at theta = pi; ``theta`` is the angle
from the pole and ``phi`` the longitude, both in radians. Everything broadcasts: parameters of shape
(b, 1, 1) with theta (t, 1) and phi (p,) give (b, t, p).

Splines see the hemisphere as a disk (:class:`DiskSplines`). A direction of zenith angle theta and
azimuth phi lies at ``r = theta / (pi/2)`` from the middle of the unit disk (azimuthal equidistant
projection)::

    (x, y) = r (sin phi, cos phi)

Over the disk lies a square lattice of n x n control points, ``2 / (n - 3)`` apart, and a function
on it is the sum of uniform cubic B-splines about them. Every direction is alike to it, the zenith
too: a map of rows and columns has a pole there. A turn about the vertical turns the disk.
"""

import math
from collections.abc import Iterator
from typing import Any, Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import grid_sample, pad

from skylight._modes import constant, on_cpu, single
from skylight._module import Module
from skylight.errors import InputError, check_shape
from skylight.sphere._frame import DirectionGrid, angles_from_direction


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


TAPS = 16


class DiskSplines(Module):
    """Splines on ``across`` x ``across`` control points, of which those that reach the disk count.

    The ``count`` control points are numbered by rows. ``zenith_rad`` and ``azimuth_rad`` are
    the directions of ``grid`` at which :meth:`forward` evaluates.
    """

    number: Tensor
    lattice: Tensor
    radius: Tensor
    azimuth_rad: Tensor

    @on_cpu
    def __init__(self, across: int, grid: DirectionGrid) -> None:
        super().__init__()
        self.across = across
        place = torch.linspace(-1, 1, across - 2, dtype=torch.float64)
        step = float(place[1] - place[0])
        place = torch.cat([place[:1] - step, place, place[-1:] + step])
        # from the centre to the nearest point of a control point's 4 x 4 cells
        nearest = (place.abs() - 2 * step).clamp(min=0)
        reaches = nearest[:, None].square() + nearest.square() < 1
        reaches = reaches.flatten()
        number = torch.where(reaches, reaches.cumsum(0) - 1, -1)
        self.count = int(reaches.sum())
        self.register_buffer("number", number, persistent=False)
        lattice = torch.where(reaches, number, self.count)  # the others are 0, which is appended
        self.register_buffer("lattice", lattice, persistent=False)
        radius, azimuth = _polar_of(grid)
        self.register_buffer("radius", radius, persistent=False)
        self.register_buffer("azimuth_rad", azimuth, persistent=False)

    def _places(
        self, turn_rad: Float[Tensor, " b"], height: int | None = None
    ) -> tuple[Float[Tensor, "b n"], Float[Tensor, "b n"]]:
        """(x, y) of every direction in cells of the lattice, the function turned to the right."""
        radius, azimuth = self.radius, self.azimuth_rad
        if height is not None:
            radius, azimuth = _polar(height, turn_rad.device).unbind()
        angle = azimuth.to(turn_rad.dtype) - turn_rad[:, None]
        radius, scale = radius.to(turn_rad.dtype), (self.across - 3) / 2
        across = scale * (radius * torch.sin(angle) + 1)
        return across, scale * (radius * torch.cos(angle) + 1)

    def taps(
        self, turn_rad: Float[Tensor, " b"], height: int | None = None
    ) -> tuple[Int[Tensor, "b n 16"], Float[Tensor, "b n 16"]]:
        """(control points, their weights) of every direction, the function turned to the right."""
        across, along = self._places(turn_rad, height)
        column, across_weights = _cubic(across, self.across - 4)
        row, along_weights = _cubic(along, self.across - 4)
        near = torch.arange(4, device=row.device)
        index = (row[..., None] + near)[..., :, None] * self.across
        index = index + (column[..., None] + near)[..., None, :]
        weights = along_weights[..., :, None] * across_weights[..., None, :]
        number = self.number.index_select(0, index.flatten()).reshape(*index.shape[:2], TAPS)
        return number, weights.flatten(-2)

    def forward(
        self,
        control: Float[Tensor, "b k c"],
        turn_rad: Float[Tensor, " t"],
        height: int | None = None,
    ) -> Float[Tensor, "b n c"]:
        """Values on the grid, or on a sky's of ``height`` rows; differentiable in both.

        One turn of all functions, or as many.
        """
        if control.dim() != 3:
            raise InputError(
                f"DiskSplines' control points of shape {tuple(control.shape)}: give (b, k, c)"
            )
        count, _, channels = control.shape
        turns = turn_rad.shape[0]  # not len, which an export takes for a constant
        check_shape("DiskSplines' control points", control.shape, self.count, channels)
        if turns not in (count, 1):
            raise InputError(f"{turns} turns of {count} functions: give 1 or {count}")
        dtype, control = control.dtype, single(control)  # eight bits do not tell places apart
        turn_rad = turn_rad.to(control.dtype)
        if torch.compiler.is_compiling():
            return self.gathered(control, turn_rad, height).to(dtype)
        images = pad(control.transpose(1, 2), (0, 1)).index_select(2, self.lattice)
        of_a_turn = channels if turns == count else count * channels
        images = images.reshape(turns, of_a_turn, self.across, self.across)
        across, along = self._places(turn_rad, height)
        values: Tensor = _Splines.apply(images, across, along)
        return values.reshape(count, channels, across.shape[1]).transpose(1, 2).to(dtype)

    def gathered(
        self,
        control: Float[Tensor, "b k c"],
        turn_rad: Float[Tensor, " t"],
        height: int | None = None,
    ) -> Float[Tensor, "b n c"]:
        """:meth:`forward` by sixteen control points each, of operations that all exporters know.

        Slow but in a graph, where a compiler makes one loop of it, twice as fast as the other.
        """
        index, weights = self.taps(turn_rad, height)
        count, channels = control.shape[0], control.shape[2]
        if index.shape[0] == count:
            index = index.flatten(1)[..., None].expand(-1, -1, channels)
            near = control.gather(1, index)
        else:  # one turn: ONNX's Gather, which a page's decoder knows, not its GatherElements
            near = control.index_select(1, index.flatten())
        near = near.unflatten(1, (-1, TAPS))
        return (near * weights[..., None]).sum(2)

    def matrix(self) -> Float[Tensor, "n k"]:
        """The linear map from control points to values on the grid, dense, float64."""
        still = torch.zeros(1, dtype=torch.float64, device=self.number.device)
        index, weights = self.taps(still)
        dense = torch.zeros(index.shape[1], self.count, dtype=torch.float64, device=index.device)
        return dense.scatter_add_(1, index[0], weights[0].double())


def _polar_of(grid: DirectionGrid) -> Float[Tensor, "2 n"]:
    """Directions on the unit disk: r, and the azimuth in rad."""
    azimuth, zenith = angles_from_direction(grid.directions)
    return torch.stack([zenith / (math.pi / 2), azimuth])


@constant(8)
def _polar(height: int, device: torch.device) -> Float[Tensor, "2 n"]:
    """Of the pixels of a sky of so many rows."""
    return _polar_of(DirectionGrid.sky(height)).to(device)


class _Splines(torch.autograd.Function):
    """Images of control points (t,c,k,k) at places (t,n) and (t,n) in cells -> (t,c,n).

    Its gradients are written out: torch's own of ``grid_sample`` has the weights' as well.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(images: Tensor, across: Tensor, along: Tensor) -> Tensor:
        return _sampled(images, _pairs(across), _pairs(along))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, ...], output: Tensor) -> None:
        ctx.save_for_backward(*inputs)
        ctx.save_for_forward(*inputs)

    @staticmethod
    def jvp(ctx: Any, *tangents: Tensor | None) -> Tensor:
        images, across, along = ctx.saved_tensors
        by_images, *by_places = tangents
        total = torch.zeros_like(_sampled(images, _pairs(across), _pairs(along)))
        if by_images is not None:
            total = total + _sampled(by_images, _pairs(across), _pairs(along))
        for slope, moved in zip(_slopes(images, across, along), by_places, strict=True):
            if moved is not None:
                total = total + slope * moved[:, None]
        return total

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        (grad,) = grads
        images, across, along = ctx.saved_tensors
        by_images, by_places = None, (None, None)
        if ctx.needs_input_grad[0]:
            by_images = torch.zeros_like(images)
            for weight, grid in _bilinear(images, _pairs(across), _pairs(along)):
                part, _ = torch.ops.aten.grid_sampler_2d_backward(
                    (weight * grad)[:, :, None], images, grid, 0, 1, True, (True, False)
                )
                by_images = by_images + part
        if ctx.needs_input_grad[1] or ctx.needs_input_grad[2]:
            slopes = _slopes(images, across, along)
            by_places = tuple((grad * slope).sum(1) for slope in slopes)
        return by_images, *by_places


# Two points of the bilinear kernel, (weights, places) each: see _pairs
_Pairs = list[tuple[Float[Tensor, "t n"], Float[Tensor, "t n"]]]


def _sampled(
    images: Float[Tensor, "t c k k"], across: _Pairs, along: _Pairs
) -> Float[Tensor, "t c n"]:
    total = None
    for weight, grid in _bilinear(images, across, along):
        part = (
            weight * grid_sample(images, grid, padding_mode="border", align_corners=True)[:, :, 0]
        )
        total = part if total is None else total + part
    assert total is not None
    return total


def _bilinear(
    images: Float[Tensor, "t c k k"], across: _Pairs, along: _Pairs
) -> Iterator[tuple[Float[Tensor, "t 1 n"], Float[Tensor, "t 1 n 2"]]]:
    """(weight, where ``grid_sample`` is to look) of the four bilinear samples."""
    scale = 2 / (images.shape[-1] - 1)
    for across_weight, x in across:
        for along_weight, y in along:
            grid = scale * torch.stack([x, y], -1)[:, None] - 1
            yield (across_weight * along_weight)[:, None], grid


def _slopes(
    images: Float[Tensor, "t c k k"], across: Float[Tensor, "t n"], along: Float[Tensor, "t n"]
) -> tuple[Float[Tensor, "t c n"], Float[Tensor, "t c n"]]:
    """Derivatives with respect to both places."""
    x, y = _pairs(across), _pairs(along)
    return _sampled(images, _pairs(across, 1), y), _sampled(images, x, _pairs(along, 1))


def _pairs(place: Float[Tensor, "t n"], order: Literal[0, 1] = 0) -> _Pairs:
    """The cubic B-spline, or its derivative, as two samples of the bilinear kernel.

    Two neighbours of weights a and b of one sign are one linear interpolation, at b / (a + b)
    between them, times a + b (Sigg & Hadwiger 2005, "Fast third-order texture filtering", GPU
    Gems 2, chapter 20).
    """
    cell = place.detach().floor()
    t = place - cell
    s = 1 - t
    if order == 0:
        a, b, c, d = s**3 / 6, 2 / 3 - t**2 + t**3 / 2, 2 / 3 - s**2 + s**3 / 2, t**3 / 6
    else:
        a, b, c, d = -(s**2) / 2, 1.5 * t**2 - 2 * t, 2 * s - 1.5 * s**2, t**2 / 2
    first, second = a + b, c + d
    return [(first, cell + b / first), (second, cell + 2 + d / second)]


def _cubic(
    place: Float[Tensor, "*s"], last: int
) -> tuple[Int[Tensor, "*s"], Float[Tensor, "*s 4"]]:
    """(cell, weights of its four control points) of the uniform cubic B-spline."""
    cell = place.detach().floor().clamp(0, last)
    t = place - cell
    s = 1 - t
    middle = 2 / 3 - t.square() + t**3 / 2, 2 / 3 - s.square() + s**3 / 2
    return cell.long(), torch.stack([s**3 / 6, *middle, t**3 / 6], -1)
