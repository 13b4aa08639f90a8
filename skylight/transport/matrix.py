"""Visibility and transport matrices of surface points under distant light, by ray casting.

Thesis, section 5.3.1: s = diag(rho) T l (Eq. 5.2) with T from Eq. 5.3.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.sphere.grid import DirectionGrid
from skylight.transport.raycast import Raycaster
from skylight.work.forked import in_processes, shared_array
from skylight.work.progress import Progress

BLOCK_DIRECTIONS = 64  # cast together; bounds the scratch memory


@dataclass(frozen=True, kw_only=True)
class TransportMatrix:
    """``matrix`` (m,n) float32 over the n directions of ``grid``.

    T[p, w] = V(p, w) <n_p, w>+ dw / pi (thesis, Eq. 5.3): albedo 1, solid angle included, so
    shading is ``albedo * (matrix @ radiance)``.
    """

    matrix: Float[Tensor, "m n"]
    grid: DirectionGrid

    def __post_init__(self) -> None:
        if self.matrix.ndim != 2 or self.matrix.shape[1] != len(self.grid):
            raise ValueError(
                f"matrix {tuple(self.matrix.shape)} must have one column for each of the "
                f"{len(self.grid)} directions"
            )

    def fold_ground(self) -> Float[Tensor, "m n_sky_1"]:
        """(m, n/2 + 1): the sky's columns, then one for a ground of uniform radiance.

        The last column is the sum over the lower half; needs a full lat-long grid.
        """
        if self.grid.layout is None or self.grid.layout[1] != 2 * self.grid.layout[0]:
            raise ValueError(f"only a full lat-long grid has a ground, got {self.grid.layout}")
        if self.grid.layout[0] % 2:
            raise ValueError(f"the horizon cuts a row of a grid {self.grid.layout}: use even rows")
        sky, ground = self.matrix.chunk(2, dim=1)
        return torch.cat([sky, ground.sum(1, keepdim=True)], dim=1)

    def on_rows(self, rows: int) -> "TransportMatrix":
        """That of light on a lat-long grid of fewer rows: columns summed over blocks.

        A direction of the coarse grid sends the same radiance from all fine pixels in it.
        """
        layout = self.grid.layout
        if layout is not None and layout[0] == rows:
            return self
        if layout is None or layout[0] % rows:
            raise ValueError(f"the transport's grid {layout} must be a multiple of {rows} rows")
        block = layout[0] // rows
        cells = self.matrix.unflatten(1, (rows, block, -1, block)).sum((2, 4))
        return TransportMatrix(matrix=cells.flatten(1), grid=DirectionGrid.latlong(rows))

    def project(self, basis: Float[Tensor, "n k"]) -> Float[Tensor, "m k"]:
        """Transport of lights written in a basis, l = basis @ coefficients."""
        return self.matrix @ basis.to(self.matrix)


def diffuse_transport(
    positions: Float[Tensor, "m 3"],
    normals: Float[Tensor, "m 3"],
    geometric_normals: Float[Tensor, "m 3"],
    raycaster: Raycaster,
    grid: DirectionGrid,
    *,
    workers: int = 1,
    progress: Progress | None = None,
) -> TransportMatrix:
    """T[p, w] = V(p, w) <n_p, w>+ dw / pi (thesis, Eq. 5.3), by one shadow ray per entry > 0.

    Parameters
    ----------
    positions : where rays start, in the raycaster's units; ``GBuffer.origins``, which are clear
        of the shadow-terminator artefact, rather than ``GBuffer.positions``.
    normals : unit, interpolated; the cosine's.
    geometric_normals : unit, of the flat faces; starts are lifted along them by
        ``raycaster.epsilon``. A direction above ``normals`` but below the flat face is cast like
        any other: from the face itself it hits the mesh, from a lifted origin it may be free.
    workers : processes, this one included. More than one needs ``fork`` (not on Windows); the
        result is the same to the byte.
    progress : called with the share that is done, in [0, 1].

    Memory: 4 m n bytes of result and about 4 m (2 * 64 + 16) bytes of scratch per worker.
    """
    points = SurfaceRays.leaving(positions, normals, geometric_normals, raycaster)
    directions = grid.directions.numpy().astype(np.float32)
    weight = (grid.solid_angles / math.pi).numpy().astype(np.float32)
    matrix = shared_array((len(positions), len(grid)), np.float32)

    def fill(block: slice) -> None:
        cosine = points.visible_cosines(directions[block])
        matrix[:, block] = (cosine * weight[block, None]).T

    _in_blocks(fill, len(grid), workers, progress)
    return TransportMatrix(matrix=torch.from_numpy(matrix), grid=grid)


def visibility(
    positions: Float[Tensor, "m 3"],
    geometric_normals: Float[Tensor, "m 3"],
    raycaster: Raycaster,
    grid: DirectionGrid,
    *,
    workers: int = 1,
    progress: Progress | None = None,
) -> Bool[Tensor, "m n"]:
    """V(p, w): whether the ray from each point in each direction of the grid is unoccluded.

    Independent of shading normals, which may therefore be optimised
    (:class:`skylight.transport.diffuse.DiffuseTransport`); twice as many rays as
    :func:`diffuse_transport`, whose parameters these are. Memory: m n bytes.
    """
    points = SurfaceRays.leaving(positions, geometric_normals, geometric_normals, raycaster)
    directions = grid.directions.numpy().astype(np.float32)
    visible = shared_array((len(positions), len(grid)), np.bool_)

    def fill(block: slice) -> None:
        for column, direction in zip(visible.T[block], directions[block], strict=True):
            column[:] = points.unoccluded(direction)

    _in_blocks(fill, len(grid), workers, progress)
    return torch.from_numpy(visible)


def _in_blocks(
    fill: Callable[[slice], None], directions: int, workers: int, progress: Progress | None
) -> None:
    in_processes(
        lambda i: fill(slice(i * BLOCK_DIRECTIONS, (i + 1) * BLOCK_DIRECTIONS)),
        -(-directions // BLOCK_DIRECTIONS),
        workers=workers,
        progress=progress,
    )


@dataclass(frozen=True, kw_only=True)
class SurfaceRays:
    """Surface points from which rays are cast: float32 starts and normals (m,3)."""

    starts: Float[np.ndarray, "m 3"]
    normals: Float[np.ndarray, "m 3"]
    raycaster: Raycaster

    @staticmethod
    def leaving(
        positions: Float[Tensor, "m 3"],
        normals: Float[Tensor, "m 3"],
        geometric_normals: Float[Tensor, "m 3"],
        raycaster: Raycaster,
    ) -> "SurfaceRays":
        """Starts lifted off the surface by the raycaster's epsilon."""
        starts = positions.double() + raycaster.epsilon * geometric_normals.double()
        return SurfaceRays(
            starts=starts.detach().float().numpy(),
            normals=normals.detach().float().numpy(),
            raycaster=raycaster,
        )

    def visible_cosines(self, directions: Float[np.ndarray, "b 3"]) -> Float[np.ndarray, "b m"]:
        """V(p, w) <n_p, w>+, one row per direction, float32.

        All rays of a row share their direction: only their starts are gathered, nothing else is
        built, and embree meets coherent rays.
        """
        out = np.zeros((len(directions), len(self.normals)), dtype=np.float32)
        for row, direction in zip(out, directions, strict=True):
            cosine = self.normals @ direction
            facing = np.flatnonzero(cosine > 0)
            free = facing[self.unoccluded(direction, facing)]
            row[free] = cosine[free]
        return out

    def unoccluded(
        self, direction: Float[np.ndarray, "3"], some: Int[np.ndarray, " k"] | None = None
    ) -> Bool[np.ndarray, " k"]:
        """V(p, w) in one direction, of all points or of those with the given indices."""
        starts = self.starts if some is None else self.starts.take(some, axis=0)
        return ~self.raycaster.occluded(
            torch.from_numpy(starts), torch.from_numpy(direction)[None]
        ).numpy()
