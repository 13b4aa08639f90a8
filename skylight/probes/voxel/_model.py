"""Voxel models: boolean grids from meshes and files, star-shaped probes, and the faces they show.

Faces have six orientations, each with a right-handed frame (right x forward = normal). The empty
cell in front of a face has four side neighbours and a ceiling; those that are occupied give one of
32 occlusion configurations, bit i of which is set where neighbour i (:data:`OCCLUDERS`) is present.
Thesis, sections 3.3.2 and 3.4.2.
"""

import struct
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations, product
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.errors import InputError
from skylight.io._atomic import atomic_path
from skylight.io._bounded import file_bytes, load_array
from skylight.transport._mesh import read_mesh

_MOST_CELLS = 512**3
_WIDEST = 255  # voxels of a star
_AXES = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}  # a quarter turn takes the first to the second


@dataclass(frozen=True, kw_only=True)
class VoxelModel:
    """``occupied[x, y, z]``: cell (x, y, z) fills the cube from that corner to one unit further.

    Axes are the world's: +Y is up. At least one cell is occupied.
    """

    occupied: Bool[np.ndarray, "x y z"]

    def __post_init__(self) -> None:
        if self.occupied.ndim != 3 or self.occupied.dtype != np.bool_:
            raise InputError(
                f"a voxel model is a boolean grid of 3 axes, got {self.occupied.dtype} of shape "
                f"{self.occupied.shape}"
            )
        if self.occupied.size > _MOST_CELLS:
            raise InputError(f"a grid of {self.occupied.shape} cells is too large: crop it")
        if not self.occupied.any():
            raise InputError("the voxel model is empty: no cell is occupied")

    def __len__(self) -> int:
        return int(self.occupied.sum())

    @cached_property
    def padded(self) -> Bool[np.ndarray, "x2 y2 z2"]:
        """With one empty cell all round."""
        return np.pad(self.occupied, 1)

    def turned(self, axis: str, quarters: int) -> "VoxelModel":
        """Turned right-handed by ``quarters`` quarter turns about +X, +Y or +Z."""
        if axis not in _AXES:
            raise InputError(f"axis {axis!r}: choose x, y or z")
        # numpy turns from the first axis towards the second
        turned = np.rot90(self.occupied, quarters, axes=_AXES[axis])
        return VoxelModel(occupied=np.ascontiguousarray(turned))

    def cropped(self) -> "VoxelModel":
        """Without the empty margin."""
        cells = np.argwhere(self.occupied)
        low, high = cells.min(0), cells.max(0) + 1
        x, y, z = (slice(a, b) for a, b in zip(low, high, strict=True))
        return VoxelModel(occupied=self.occupied[x, y, z].copy())


def star_probe(size: int) -> VoxelModel:
    """The "N-probe": all cells with ``|x| + |y| + |z| <= (N - 1) / 2``; a cross of seven for N = 3.

    Thesis, section 3.4.5 and Fig. 3.8.
    """
    if size < 1 or size % 2 == 0 or size > _WIDEST:
        raise InputError(
            f"a star-shaped probe is an odd number of voxels wide, up to {_WIDEST}, got {size}"
        )
    offset = np.abs(np.arange(size) - size // 2)
    distance = offset[:, None, None] + offset[None, :, None] + offset[None, None, :]
    return VoxelModel(occupied=distance <= size // 2)


def read_voxels(path: str | Path, *, resolution: int = 32) -> VoxelModel:
    """A voxel model from .npy (boolean grid), .vox (MagicaVoxel), or a mesh file.

    Meshes are voxelised solid, ``resolution`` cells along their longest side.

    Raises
    ------
    InputError
        The file cannot be read as what its name says, or holds no voxel.
    """
    path = Path(path)
    if path.suffix.lower() == ".npy":
        return _read_npy(path)
    if path.suffix.lower() == ".vox":
        return _read_vox(path)
    return voxelise(path, resolution)


def probe_model(probe: int | None, voxels: Path | None, resolution: int) -> tuple[VoxelModel, str]:
    """(model, title) that the command line's options describe: a star, or a file."""
    if (probe is None) == (voxels is None):
        raise InputError("give either --probe, such as 3, or --voxels with a file")
    if probe is not None:
        return star_probe(probe), f"{probe}-probe"
    assert voxels is not None
    return read_voxels(voxels, resolution=resolution).cropped(), voxels.name


def write_voxels(path: Path, model: VoxelModel) -> None:
    """As .npy."""
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.save(stream, model.occupied)


def voxelise(path: Path, resolution: int) -> VoxelModel:
    """Cells of a mesh file with their centre inside, or with the surface going through them."""
    if not 1 <= resolution <= 256:
        raise InputError(f"a resolution of 1 to 256 voxels, got {resolution}")
    import trimesh

    vertices, faces = read_mesh(path)
    mesh = trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=True)
    pitch = float(mesh.extents.max()) / resolution
    if not pitch > 0:
        raise InputError(f"{path}: the mesh is a point")
    # trimesh has cells' centres, not their borders, at multiples of the pitch; a hair smaller, so
    # that a side which lies in a border counts for the cell within
    middle = mesh.bounds.mean(0)
    mesh.vertices = (mesh.vertices - middle) * (1 - 1e-6) + (middle - mesh.bounds[0] - pitch / 2)
    grid = mesh.voxelized(pitch)
    assert grid is not None
    grid = grid.fill()
    return VoxelModel(occupied=np.ascontiguousarray(grid.matrix.astype(bool))).cropped()


def _read_npy(path: Path) -> VoxelModel:
    try:
        grid = load_array(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as a .npy file ({error})") from error
    if grid.dtype.kind not in "biuf":
        raise InputError(f"{path}: holds no grid of booleans")
    if grid.ndim != 3 or not (grid.dtype == bool or np.isin(grid, [0, 1]).all()):
        raise InputError(
            f"{path}: holds {grid.dtype} of shape {grid.shape}, expected a grid (x, y, z) of "
            "booleans, or of 0 and 1"
        )
    return VoxelModel(occupied=grid.astype(bool))


def _read_vox(path: Path) -> VoxelModel:
    """The first model of a MagicaVoxel file, whose z is up: chunks SIZE and XYZI (version 150).

    https://github.com/ephtracy/voxel-model/blob/master/MagicaVoxel-file-format-vox.txt
    """
    try:
        data = file_bytes(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from error
    if data[:4] != b"VOX ":
        raise InputError(f"{path}: not a MagicaVoxel file, which begins with 'VOX '")
    size: tuple[int, ...] | None = None
    try:
        content = struct.unpack_from("<i", data, 12)[0]
        if content < 0:
            raise ValueError("a chunk of negative length")
        place = 20 + content  # past the header and MAIN's content
        while place + 12 <= len(data):
            name = data[place : place + 4]
            length, children = struct.unpack_from("<ii", data, place + 4)
            if length < 0 or children < 0:
                raise ValueError("a chunk of negative length")
            place += 12
            if name == b"SIZE":
                size = struct.unpack_from("<iii", data, place)
            elif name == b"XYZI":
                if size is None:
                    raise ValueError("voxels before their size")
                return _from_xyzi(data[place : place + length], size)
            place += length + children
    except (struct.error, ValueError, IndexError) as error:
        raise InputError(f"{path}: damaged MagicaVoxel file ({error})") from error
    raise InputError(f"{path}: holds no voxels (no XYZI chunk)")


def _from_xyzi(chunk: bytes, size: tuple[int, ...]) -> VoxelModel:
    if min(size) < 1 or np.prod(size, dtype=np.int64) > _MOST_CELLS:
        raise ValueError(f"size {size}")
    (count,) = struct.unpack_from("<I", chunk)
    cells = np.frombuffer(chunk, np.uint8, 4 * count, 4).reshape(count, 4)[:, :3].astype(int)
    grid = np.zeros(size, bool)
    grid[tuple(cells.T)] = True
    # (x, y, z up) to (x, y up, z): y = z_vox, z = -y_vox
    return VoxelModel(occupied=np.ascontiguousarray(grid[:, ::-1].transpose(0, 2, 1)))


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
