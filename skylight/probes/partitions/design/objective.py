"""Relighting error of a probe design on a test scene, over many lights at once."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.partitions.cells import Cells
from skylight.sphere.envmap import shift_columns
from skylight.sphere.grid import DirectionGrid


class RelightingError:
    """Mean over lights of a scene's relative MAE under direct light: ``|T (L - L^)| / mean T L``.

    L^ is constant in each cell (thesis, Eq. 4.5)::

        L^_i = int_cell_i <n_i, w> L dw / int_cell_i <n_i, w> dw

    transport : (m,d), of m points of the scene and the d directions of ``grid``, with albedo,
        shadows and solid angles.
    lights : (b,d,c) radiance, c colours. Scaled here so that each makes a mean shading of 1, so
        that bright and dim lights count the same.
    """

    def __init__(
        self,
        transport: Float[Tensor, "m d"],
        lights: Float[Tensor, "b d c"],
        grid: DirectionGrid,
    ) -> None:
        rows = transport.mean(0).double()
        # float64 sums: a lamp is 1e5 times brighter than what it is added to
        mean = torch.stack([(rows @ light.double()).mean() for light in lights])
        if not bool((mean > 0).all()):
            raise InputError(f"light {int(mean.argmin())} leaves the scene black: take it out")
        scaled = lights.double() / mean[:, None, None]
        self._lights = scaled.permute(1, 0, 2).flatten(1).float().contiguous()
        # most directions below the ground light nothing
        self._lit = torch.nonzero(transport.any(0))[:, 0]
        self._columns = transport.T[self._lit].float().contiguous()
        self._true = transport.float() @ self._lights
        self._directions = grid.directions.float()
        self._solid_angles = grid.solid_angles.float()

    def of_seeds(self, seeds: Float[Tensor, "n 3"]) -> float:
        """Of a design in which each unit seed is a cell; infinite where one holds no direction."""
        seeds = seeds.float()
        return self._of(seeds, (self._directions @ seeds.T).argmax(1))

    def of_cells(self, cells: Cells) -> float:
        """Of any design."""
        return self._of(cells.normals.float(), cells.cell_of(self._directions))

    def relaxed(
        self, seeds: Float[Tensor, "n 3"], sharpness: float | Float[Tensor, ""]
    ) -> Float[Tensor, ""]:
        """:meth:`of_seeds` with cells that blend into each other, differentiable in the seeds.

        Direction w belongs to cell i by the share ``softmax_i(sharpness <w, x_i>)``, which tends
        to the closest seed x_i as the sharpness grows.
        """
        seeds = seeds.float()
        near = self._directions @ seeds.T
        member = torch.softmax(sharpness * near, dim=1)
        cosine = member * near.clamp(min=0) * self._solid_angles[:, None]
        mean = (cosine / cosine.sum(0)).T @ self._lights
        shading = self._columns.T @ (member[self._lit] @ mean)
        return (shading - self._true).abs().mean()

    def _of(self, normals: Float[Tensor, "n 3"], cell: Int[Tensor, " d"]) -> float:
        cosine = (normals[cell] * self._directions).sum(1) * self._solid_angles
        total = cosine.new_zeros(len(normals)).index_add_(0, cell, cosine)
        if not bool((total > 0).all()):
            return math.inf
        share = cosine.new_zeros(len(normals), len(cell))
        share[cell, torch.arange(len(cell))] = cosine / total[cell]
        transfer = cosine.new_zeros(len(normals), self._columns.shape[1])
        transfer.index_add_(0, cell[self._lit], self._columns)
        shading = transfer.T @ (share @ self._lights)
        return float(shading.sub_(self._true).abs_().mean())


def turned_about_vertical(
    maps: Float[Tensor, "k h w c"], turns: int, generator: torch.Generator
) -> Float[Tensor, "b d c"]:
    """Each map turned ``turns`` times, evenly from a random start; b = k turns, d = h w."""
    start = torch.rand(len(maps), 1, generator=generator)
    angle = (start + torch.arange(turns)) * (2 * math.pi / turns)
    return shift_columns(maps.repeat_interleave(turns, 0), angle.flatten()).flatten(1, 2)
