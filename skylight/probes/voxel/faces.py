"""Exposed faces of voxel models, their orientation and occlusion.

Six orientations, each with a right-handed frame (right x forward = normal). The empty cell in
front of a face has four side neighbours and a ceiling; those that are occupied give one of 32
occlusion configurations, bit i of which is set where neighbour i (:data:`OCCLUDERS`) is present.
Thesis, sections 3.3.2 and 3.4.2.
"""

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.probes.voxel.model import VoxelModel

OCCLUDERS = ("left", "right", "forward", "backward", "top")
ORIENTATIONS = ("+x", "-x", "+y", "-y", "+z", "-z")
CONFIGURATIONS = 32

NORMALS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
# up on the sides; -Z on top, as a map on a table has its far side up, and +Z below
FORWARD = np.array([[0, 1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1], [0, 1, 0], [0, 1, 0]])
RIGHT = np.cross(FORWARD, NORMALS)


@dataclass(frozen=True, kw_only=True)
class VoxelFaces:
    """Exposed faces of a model, ordered by orientation, then cell.

    ``corners`` in the model's units: at (left, backward), (right, backward), (right, forward) and
    (left, forward), which is counter-clockwise seen from outside.
    """

    cells: Int[Tensor, "f 3"]
    orientation: Int[Tensor, " f"]
    configuration: Int[Tensor, " f"]
    corners: Float[Tensor, "f 4 3"]

    def __len__(self) -> int:
        return len(self.cells)

    def triangles(self) -> tuple[Float[Tensor, "n 3"], Int[Tensor, "t 3"]]:
        """(vertices, triangles): four vertices of its own and triangles 2 i, 2 i + 1 for face i."""
        first = 4 * torch.arange(len(self))[:, None]
        pair = torch.cat([first + torch.tensor([0, 1, 2]), first + torch.tensor([0, 2, 3])], 1)
        return self.corners.reshape(-1, 3), pair.reshape(-1, 3)

    @property
    def slot(self) -> Int[Tensor, " f"]:
        """The number of each face's slot, 0 to 191."""
        return self.orientation * CONFIGURATIONS + self.configuration

    def counts(self) -> Int[Tensor, "6 32"]:
        """How many faces each slot has."""
        slots = len(ORIENTATIONS) * CONFIGURATIONS
        return torch.bincount(self.slot, minlength=slots).reshape(-1, CONFIGURATIONS)

    def points(self, size: int) -> Float[Tensor, "f size size 3"]:
        """Centres of ``size`` x ``size`` texels; row 0 lies forward, column 0 left."""
        return places_on(self.corners, (torch.arange(size, dtype=torch.float64) + 0.5) / size)


def places_on(
    corners: Float[Tensor, "f 4 3"], along: Float[Tensor, " n"]
) -> Float[Tensor, "f n n 3"]:
    """Places on squares at shares ``along`` of their sides, from forward back and from left."""
    origin = corners[:, 3]  # left, forward
    right, back = corners[:, 2] - origin, corners[:, 0] - origin
    return (
        origin[:, None, None]
        + along[:, None, None] * back[:, None, None]
        + along[:, None] * right[:, None, None]
    )


def exposed_faces(model: VoxelModel) -> VoxelFaces:
    """Every face of an occupied cell whose front cell is empty."""
    solid = model.padded
    cells, orientations, configurations, corners = [], [], [], []
    for o in range(len(NORMALS)):
        front_empty = ~_shifted(solid, NORMALS[o])
        here = np.argwhere(solid & front_empty)
        front = here + NORMALS[o]
        present = [occupied_at(solid, front + step) for step in _neighbours(o)]
        cells.append(here - 1)  # without the padding
        orientations.append(np.full(len(here), o))
        configurations.append(sum(p.astype(np.int64) << i for i, p in enumerate(present)))
        centre = here - 1 + 0.5 + 0.5 * NORMALS[o]
        square = [
            centre + 0.5 * (s * RIGHT[o] + t * FORWARD[o])
            for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        corners.append(np.stack(square, 1))
    return VoxelFaces(
        cells=torch.from_numpy(np.concatenate(cells)),
        orientation=torch.from_numpy(np.concatenate(orientations)),
        configuration=torch.from_numpy(np.concatenate(configurations)),
        corners=torch.from_numpy(np.concatenate(corners)),
    )


def visibility_vectors() -> Float[Tensor, "32 5"]:
    """v: 0 where the neighbour is present, 1 where light comes from there (section 3.4.2)."""
    bits = torch.arange(CONFIGURATIONS)[:, None] >> torch.arange(len(OCCLUDERS))
    return 1.0 - (bits & 1).double()


def quarter_turns() -> list[Int[np.ndarray, "3 3"]]:
    """The 24 rotations of a cube, the identity first."""
    signed = []
    for order in permutations(range(3)):
        for signs in product((1, -1), repeat=3):
            matrix = np.zeros((3, 3), np.int64)
            matrix[range(3), order] = signs
            if round(np.linalg.det(matrix)) == 1:
                signed.append(matrix)
    return sorted(signed, key=lambda m: -np.trace(m))


def _neighbours(orientation: int) -> list[Int[np.ndarray, " 3"]]:
    """Steps from the front cell, in the order of :data:`OCCLUDERS`."""
    right, forward, normal = RIGHT[orientation], FORWARD[orientation], NORMALS[orientation]
    return [-right, right, forward, -forward, normal]


def _shifted(solid: np.ndarray, step: np.ndarray) -> np.ndarray:
    """What is one step further; the padding is empty, so nothing comes in on the other side."""
    return np.roll(solid, tuple(-step), axis=(0, 1, 2))


def occupied_at(solid: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Whether cells are occupied; outside of the grid none is."""
    inside = ((cells >= 0) & (cells < solid.shape)).all(1)
    result = np.zeros(len(cells), bool)
    result[inside] = solid[tuple(cells[inside].T)]
    return result
