"""What points see of a full lat-long grid, by fewer rays: cast where visibility changes."""

from functools import partial

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from skylight.sphere.grid import DirectionGrid
from skylight.transport.matrix import SeenDirections, SurfaceRays
from skylight.transport.raycast import Raycaster
from skylight.work.forked import in_processes, shared_array
from skylight.work.progress import Progress

_NOT_CAST, _BLOCKED, _FREE = np.uint8(0), np.uint8(1), np.uint8(2)
_CELLS = (4, 2)  # directions a side, coarse to fine


def adaptive_visibility(
    positions: Float[Tensor, "m 3"],
    normals: Float[Tensor, "m 3"],
    geometric_normals: Float[Tensor, "m 3"],
    raycaster: Raycaster,
    height: int,
    *,
    workers: int = 1,
    progress: Progress | None = None,
) -> SeenDirections:
    """What :func:`~skylight.transport.matrix.diffuse_transport` finds on ``height`` rows, by a
    sixth of its rays.

    Of each cell of 4 x 4 directions one is cast. The three half a cell away lie between it and
    those of the cells to the right, below and across: where all four that are above a point's
    horizon agree, so do the three; elsewhere they are cast. Then the same for cells of 2 x 2.
    What is missed are occluders, or gaps, narrower than four directions that lie between those
    cast. Of heads on 64 rows (11 degrees) 0.2 % of the entries differ, and sums over the sky by
    less than 0.1 % (root mean square).

    The other parameters are those of ``diffuse_transport``. Memory: 2 m n bytes.

    Raises
    ------
    ValueError
        ``height`` is no multiple of 4.
    """
    if height % _CELLS[0]:
        raise ValueError(f"rows are a multiple of {_CELLS[0]}, got {height}")
    grid = DirectionGrid.latlong(height)
    points = SurfaceRays.leaving(positions, normals, geometric_normals, raycaster)
    directions = grid.directions.numpy().astype(np.float32).reshape(height, 2 * height, 3)
    found = shared_array((height, 2 * height, len(positions)), np.uint8)
    nothing = np.full((1, 1), _NOT_CAST)

    def look(
        row: int,
        columns: slice,
        known: UInt8[np.ndarray, "#c #m"],
        wanted: Bool[np.ndarray, "#c #m"],
    ) -> None:
        """Cast the ``wanted`` rays of a row; the others are ``known``."""
        here = directions[row, columns]
        above = points.cosines(here) > 0
        seen = np.where(wanted, _FREE, known)
        seen = np.where(points.blocked(here, above & wanted), _BLOCKED, seen)
        np.multiply(seen, above, out=found[row, columns])  # others are not cast

    def look_first(i: int) -> None:
        step = _CELLS[0]
        look(step * i, slice(0, None, step), nothing, nothing == _NOT_CAST)

    def look_between(step: int, i: int) -> None:
        known, mixed = _agreement(found[::step, ::step], i)
        for down, right in ((0, step // 2), (step // 2, 0), (step // 2, step // 2)):
            look(step * i + down, slice(right, None, step), known, mixed)

    stages = [(look_first, _CELLS[0]), *((partial(look_between, step), step) for step in _CELLS)]
    for number, (work, step) in enumerate(stages):

        def told(share: float, number: int = number) -> None:
            if progress is not None:
                progress((number + share) / len(stages))

        in_processes(work, height // step, workers=workers, progress=told)
    visible = torch.from_numpy(found.reshape(-1, len(positions)) == _FREE).T
    return SeenDirections(visible=visible, normals=normals, grid=grid)


def _agreement(
    found: UInt8[np.ndarray, "r c m"], i: int
) -> tuple[UInt8[np.ndarray, "c m"], Bool[np.ndarray, "c m"]]:
    """(what the four rays about each cell of a row found, where they differ or there is none).

    Below the last row of cells there are no others: all of it is to be cast.
    """
    if i + 1 == len(found):
        return found[i], np.ones_like(found[i], dtype=bool)
    both = found[i] | found[i + 1]
    union = both | np.roll(both, -1, axis=0)
    return union, (union == 0) | (union == (_BLOCKED | _FREE))
