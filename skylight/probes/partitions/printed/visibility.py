"""Visibility of each cell from the faces of a printed partition probe, by ray casting.

Walls are not infinitely thin, nor are faces at the centre: a face loses some of its own cell's
light to the walls, the pins and the pole, and, seen from ``kernel_mm`` above the centre, the walls
end before the cell does, so that light of neighbouring cells leaks in. Surfaces are taken to be
black but for the faces: what a black paint of some 4 % reflects is not in here.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.probes.partitions.cells import Cells
from skylight.sphere.grid import DirectionGrid
from skylight.transport.raycast import Raycaster

DIRECTIONS = 40_000  # over the sphere; a face's hemisphere holds half of them
_DISC = 0.25  # of a face's free radius, about its centre


@dataclass(frozen=True, kw_only=True, eq=False)
class Visibility:
    """``response`` A (n,n): int_cell j V_i(w) <n_i, w>+ dw, and the ideal of each face (n,)."""

    response: Float[Tensor, "n n"]
    facing: Float[Tensor, " n"]

    @property
    def loss(self) -> Float[Tensor, " n"]:
        """1 - A_ii / facing_i: the share of its own cell that a face does not get."""
        return 1 - self.response.diagonal() / self.facing

    @property
    def leak(self) -> Float[Tensor, " n"]:
        """sum_{j != i} A_ij / facing_i: what it gets from other cells."""
        return (self.response.sum(1) - self.response.diagonal()) / self.facing


def measure_visibility(
    cells: Cells,
    caster: Raycaster,
    *,
    centres: Float[np.ndarray, "n 3"],
    radii: Float[np.ndarray, " n"],
    rotation: Float[np.ndarray, "3 3"],
    directions: int = DIRECTIONS,
) -> Visibility:
    """From discs about the faces' centres, in the frame of the geometry.

    Each ray of a Hammersley set starts at another place of a disc of a quarter of the face's free
    radius. Of each cell the seen share is estimated, weighed by the cosine, and multiplied with
    the exact integral, which leaves no error of quadrature where all or nothing is seen.

    Parameters
    ----------
    centres, radii
        Of the faces, and how far round them they are flat and free.
    rotation
        From the probe's frame to that of ``centres`` and the geometry.
    """
    grid = DirectionGrid.hammersley(directions).directions.double()
    owner = cells.cell_of(grid)
    exact = cells.clamped_cosine(cells.normals)
    turn = torch.from_numpy(rotation)
    number = torch.arange(directions, dtype=torch.float64)
    # the plastic number's sequence (Roberts 2018)
    u, v = (number * 0.7548776662466927) % 1, (number * 0.5698402909980532) % 1
    disc = (
        torch.stack([torch.cos(2 * torch.pi * v), torch.sin(2 * torch.pi * v)], 1)
        * u.sqrt()[:, None]
    )
    rows = []
    for cell, normal in enumerate(cells.normals):
        cosine = grid @ normal
        ahead = cosine > 0
        axis = torch.nn.functional.one_hot(normal.abs().argmin(), 3).double()
        across = torch.nn.functional.normalize(torch.linalg.cross(axis, normal), dim=0)
        frame = torch.stack([across, torch.linalg.cross(normal, across)])
        offset = _DISC * float(radii[cell]) * disc[ahead] @ frame + caster.epsilon * normal
        start = torch.from_numpy(centres[cell]) + offset @ turn.T
        free = ~caster.occluded(start, grid[ahead] @ turn.T)
        total = torch.zeros(cells.count, dtype=torch.float64)
        total.index_add_(0, owner[ahead], cosine[ahead])
        seen = torch.zeros_like(total).index_add_(0, owner[ahead], cosine[ahead] * free)
        share = torch.where(total > 0, seen / total.clamp(min=1e-12), 0.0)
        rows.append(share * exact[cell])
    return Visibility(response=torch.stack(rows), facing=cells.facing)
