"""What a turned camera sees, under light in the world's frame."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from scipy.sparse import csr_matrix
from torch import Tensor

from skylight.sphere.envmap import bilinear_taps
from skylight.sphere.frame import pixel_from_direction
from skylight.sphere.grid import DirectionGrid
from skylight.transport.matrix import TransportMatrix
from skylight.transport.observation import Observation


def in_world(observation: Observation, world_from_camera: Float[ndarray, "3 3"]) -> Observation:
    """The observation of a camera that stands in the world by that rotation.

    With B the bilinear look-up of the world's light in the directions of the camera's grid,
    l_camera = B l_world, its transport is T B: exact for light that is the same everywhere, and for
    turns about the vertical by whole columns; else light is blurred by less than a pixel.
    """
    turned = torch.from_numpy(np.asarray(world_from_camera, dtype=np.float64))
    normal_modes = observation.normal_modes
    if normal_modes is not None:
        look_up = _look_up(normal_modes.grid, turned)
        # T of a matrix of visible solid angles; the modes are vectors
        modes = torch.einsum("dc,mck->mdk", turned.to(normal_modes.modes), normal_modes.modes)
        visible = _times(normal_modes.visible, look_up)
        normal_modes = replace(normal_modes, modes=modes, visible=visible)
    look_up = _look_up(observation.transport.grid, turned)

    def moved(transport: TransportMatrix) -> TransportMatrix:
        return replace(transport, matrix=_times(transport.matrix, look_up))

    return replace(
        observation,
        transport=moved(observation.transport),
        gloss=None if observation.gloss is None else moved(observation.gloss),
        normal_modes=normal_modes,
    )


def _times(matrix: Float[Tensor, "m n"], look_up: csr_matrix) -> Float[Tensor, "m n"]:
    return torch.from_numpy(np.ascontiguousarray((look_up.T @ matrix.numpy().T).T))


def _look_up(grid: DirectionGrid, world_from_camera: Float[Tensor, "3 3"]) -> csr_matrix:
    """B, one row for each of the camera's directions; across the poles as maps are continued."""
    assert grid.layout is not None
    height, width = grid.layout
    row, column = pixel_from_direction(grid.directions @ world_from_camera.T, height, width)
    index, weights = bilinear_taps(height, width, row, column)
    count = len(grid)
    places = np.repeat(np.arange(count), 4), index.flatten().numpy()
    return csr_matrix((weights.flatten().float().numpy(), places), shape=(count, count))
