"""Voxel models whose slots are known by how they were put together."""

import numpy as np
import torch

from skylight.probes.voxel._model import (
    FORWARD,
    NORMALS,
    RIGHT,
    VoxelFaces,
    VoxelModel,
    exposed_faces,
    star_probe,
)


def face_among(orientation: int, configuration: int) -> tuple[VoxelFaces, int]:
    """(faces, the one in question) of a cell and the neighbours that its face is occluded by."""
    normal, right, forward = NORMALS[orientation], RIGHT[orientation], FORWARD[orientation]
    solid = np.zeros((3, 3, 3), bool)
    middle = np.array([1, 1, 1])
    solid[tuple(middle - normal)] = True
    for i, step in enumerate((-right, right, forward, -forward, normal)):
        if configuration >> i & 1:
            solid[tuple(middle + step)] = True
    faces = exposed_faces(VoxelModel(occupied=solid))
    cell = torch.from_numpy(middle - normal)
    here = (faces.orientation == orientation) & (faces.cells == cell).all(1)
    (number,) = torch.nonzero(here)[:, 0].tolist()
    return faces, number


def known_of(size: int) -> torch.Tensor:
    """Which slots the star-shaped probe of so many voxels shows."""
    return exposed_faces(star_probe(size)).counts() > 0
