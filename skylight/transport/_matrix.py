"""Visibility and transport matrices of surface points under distant light, by ray casting.

Thesis, section 5.3.1: s = diag(rho) T l (Eq. 5.2) with T from Eq. 5.3.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.sphere._frame import DirectionGrid
from skylight.transport._rays import OcclusionCaster
from skylight.work._processes import in_processes, shared_array
from skylight.work._progress import Progress

BLOCK_DIRECTIONS = 64  # worked on together; bounds the scratch memory
_ENTRIES = 2**17  # of a matrix that are made together, in a core's cache


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
        # torch's own sum over two dimensions takes ten times as long
        strips = reduce(torch.add, self.matrix.unflatten(1, (rows, block, -1)).unbind(2))
        cells = reduce(torch.add, strips.unflatten(2, (-1, block)).unbind(3))
        return TransportMatrix(matrix=cells.flatten(1), grid=DirectionGrid.latlong(rows))

    def project(self, basis: Float[Tensor, "n k"]) -> Float[Tensor, "m k"]:
        """Transport of lights written in a basis, l = basis @ coefficients."""
        return self.matrix @ basis.to(self.matrix)


@dataclass(frozen=True, kw_only=True)
class SeenDirections:
    """What points of unit ``normals`` see; ``[rows]`` are some rows of their transport matrix.

    A byte for each entry where the matrix takes four. ``visible`` counts only above the horizons.
    """

    visible: Bool[Tensor, "m n"]
    normals: Float[Tensor, "m 3"]
    grid: DirectionGrid

    def __getitem__(self, rows: slice | Int[Tensor, " b"]) -> Float[Tensor, "b n"]:
        normals, visible = self.normals[rows], self.visible[rows]
        directions, scale = self.grid.directions.float().T, self.grid.solid_angles / math.pi
        matrix = torch.empty(visible.shape)
        count = max(1, _ENTRIES // len(self.grid))
        # booleans, unlike bytes, are slow to multiply with
        every = (matrix, normals, visible.view(torch.uint8))
        for part, towards, seen in zip(*(each.split(count) for each in every), strict=True):
            torch.mm(towards.float(), directions, out=part)
            part.clamp_(min=0).mul_(scale.float()).mul_(seen)
        return matrix

    def transport(self, rows: int | None = None) -> TransportMatrix:
        """The matrix; of light on a lat-long grid of fewer ``rows`` without making it whole."""
        if rows is None:
            return TransportMatrix(matrix=self[:], grid=self.grid)
        count = max(1, _ENTRIES // len(self.grid))
        parts = [
            TransportMatrix(matrix=self[first : first + count], grid=self.grid).on_rows(rows).matrix
            for first in range(0, len(self.normals), count)
        ]
        return TransportMatrix(matrix=torch.cat(parts), grid=DirectionGrid.latlong(rows))


def diffuse_transport(
    positions: Float[Tensor, "m 3"],
    normals: Float[Tensor, "m 3"],
    geometric_normals: Float[Tensor, "m 3"],
    raycaster: OcclusionCaster,
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
    workers : processes, this one included. More than one needs ``fork`` (not on Windows) and a
        raycaster on the CPU; the result is the same to the byte.
    progress : called with the share that is done, in [0, 1].

    Memory: 4 m n bytes of result and about 4 m (2 * 64) bytes and 6 MB of scratch per worker.
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
    raycaster: OcclusionCaster,
    grid: DirectionGrid,
    *,
    workers: int = 1,
) -> Bool[Tensor, "m n"]:
    """V(p, w): whether the ray from each point in each direction of the grid is unoccluded.

    Independent of shading normals, which may therefore be optimised
    (:class:`skylight.transport._reflection.DiffuseTransport`); twice as many rays as
    :func:`diffuse_transport`, whose parameters of the same names these are. Memory: m n bytes.
    """
    points = SurfaceRays.leaving(positions, geometric_normals, geometric_normals, raycaster)
    directions = grid.directions.numpy().astype(np.float32)
    visible = shared_array((len(positions), len(grid)), np.bool_)

    def fill(block: slice) -> None:
        for column, direction in zip(visible.T[block], directions[block], strict=True):
            column[:] = points.unoccluded(direction)

    _in_blocks(fill, len(grid), workers, None)
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
    """Surface points from which rays are cast: float32 starts and normals."""

    starts: Float[np.ndarray, "m 3"]
    normals: Float[np.ndarray, "3 m"]
    raycaster: OcclusionCaster

    @staticmethod
    def leaving(
        positions: Float[Tensor, "m 3"],
        normals: Float[Tensor, "m 3"],
        geometric_normals: Float[Tensor, "m 3"],
        raycaster: OcclusionCaster,
    ) -> "SurfaceRays":
        """Starts lifted off the surface by the raycaster's epsilon."""
        starts = positions.double() + raycaster.epsilon * geometric_normals.double()
        return SurfaceRays(
            starts=starts.detach().float().numpy(),
            normals=normals.detach().float().T.contiguous().numpy(),
            raycaster=raycaster,
        )

    def visible_cosines(self, directions: Float[np.ndarray, "b 3"]) -> Float[np.ndarray, "b m"]:
        """V(p, w) <n_p, w>+, one row per direction, float32."""
        cosine = self.cosines(directions)
        cosine[self.blocked(directions, cosine > 0)] = 0
        return cosine

    def cosines(self, directions: Float[np.ndarray, "b 3"]) -> Float[np.ndarray, "b m"]:
        """<n_p, w>+"""
        # BLAS would start threads, which processes that work beside this one have no cores for
        return np.maximum(np.einsum("dk,km->dm", directions, self.normals), 0)

    def blocked(
        self, directions: Float[np.ndarray, "b 3"], wanted: Bool[np.ndarray, "b m"]
    ) -> Bool[np.ndarray, "b m"]:
        """Which of the ``wanted`` rays hit something.

        Rays are cast direction by direction, so that embree meets coherent ones, and many
        directions at once: of a few hundred points, calls would cost as much as rays.
        """
        hit = np.zeros_like(wanted)
        count = max(1, self.raycaster.most_rays // max(1, len(self.starts)))
        for first in range(0, len(directions), count):
            some = slice(first, first + count)
            row, point = np.nonzero(wanted[some])
            hit[some][row, point] = self.raycaster.occluded(
                torch.from_numpy(self.starts[point]), torch.from_numpy(directions[some][row])
            ).numpy()
        return hit

    def unoccluded(self, direction: Float[np.ndarray, "3"]) -> Bool[np.ndarray, " m"]:
        """V(p, w) of all points in one direction."""
        return ~self.raycaster.occluded(
            torch.from_numpy(self.starts), torch.from_numpy(direction)[None]
        ).numpy()
