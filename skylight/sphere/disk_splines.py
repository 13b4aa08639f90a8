"""Cubic B-splines on the hemisphere, seen as a disk.

A direction of zenith angle theta and azimuth phi lies at ``r = theta / (pi/2)`` from the middle
of the unit disk (azimuthal equidistant projection)::

    (x, y) = r (sin phi, cos phi)

Over the disk lies a square lattice of n x n control points, ``2 / (n - 3)`` apart, and a function
on it is the sum of uniform cubic B-splines about them. Every direction is alike to it, the zenith
too: a map of rows and columns has a pole there. A turn about the vertical turns the disk.
"""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from skylight.sphere.frame import angles_from_direction
from skylight.sphere.grid import DirectionGrid

TAPS = 16


class DiskSplines(nn.Module):
    """Splines on ``across`` x ``across`` control points, of which those that reach the disk count.

    The ``count`` control points are numbered by rows. ``zenith_rad`` and ``azimuth_rad`` are
    the directions of ``grid`` at which :meth:`forward` evaluates.
    """

    number: Tensor
    radius: Tensor
    azimuth_rad: Tensor

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
        azimuth, zenith = angles_from_direction(grid.directions)
        self.register_buffer("radius", zenith / (math.pi / 2), persistent=False)
        self.register_buffer("azimuth_rad", azimuth, persistent=False)

    def taps(
        self, turn_rad: Float[Tensor, " b"]
    ) -> tuple[Int[Tensor, "b n 16"], Float[Tensor, "b n 16"]]:
        """(control points, their weights) of every direction, the function turned to the right."""
        angle = self.azimuth_rad.to(turn_rad) - turn_rad[:, None]
        radius, scale = self.radius.to(turn_rad), (self.across - 3) / 2
        across = scale * (radius * torch.sin(angle) + 1)
        along = scale * (radius * torch.cos(angle) + 1)
        column, across_weights = _cubic(across, self.across - 4)
        row, along_weights = _cubic(along, self.across - 4)
        near = torch.arange(4, device=row.device)
        index = (row[..., None] + near)[..., :, None] * self.across
        index = index + (column[..., None] + near)[..., None, :]
        weights = along_weights[..., :, None] * across_weights[..., None, :]
        number = self.number.index_select(0, index.flatten()).reshape(*index.shape[:2], TAPS)
        return number, weights.flatten(-2)

    def forward(
        self, control: Float[Tensor, "b k c"], turn_rad: Float[Tensor, " t"]
    ) -> Float[Tensor, "b n c"]:
        """Values on the grid, differentiable in both; one turn of all, or as many as functions."""
        index, weights = self.taps(turn_rad)
        if len(turn_rad) == 1:
            near = control.index_select(1, index.flatten())
        else:
            first = self.count * torch.arange(len(control), device=control.device)
            index = index + first[:, None, None]
            near = control.flatten(0, 1).index_select(0, index.flatten())
        near = near.reshape(control.shape[0], index.shape[1], TAPS, control.shape[2])
        return (near * weights[..., None]).sum(2)

    def matrix(self) -> Float[Tensor, "n k"]:
        """The linear map from control points to values on the grid, dense, float64."""
        still = torch.zeros(1, dtype=torch.float64, device=self.number.device)
        index, weights = self.taps(still)
        dense = torch.zeros(index.shape[1], self.count, dtype=torch.float64, device=index.device)
        return dense.scatter_add_(1, index[0], weights[0].double())


def _cubic(
    place: Float[Tensor, "*s"], last: int
) -> tuple[Int[Tensor, "*s"], Float[Tensor, "*s 4"]]:
    """(cell, weights of its four control points) of the uniform cubic B-spline."""
    cell = place.detach().floor().clamp(0, last)
    t = place - cell
    s = 1 - t
    middle = 2 / 3 - t.square() + t**3 / 2, 2 / 3 - s.square() + s**3 / 2
    return cell.long(), torch.stack([s**3 / 6, *middle, t**3 / 6], -1)
