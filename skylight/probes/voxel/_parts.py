"""The parts of a printed voxel probe: one thin-walled cube per voxel.

Each part is open on the side towards its parent and carries a square collar for each child. It is
printed on the side across from the opening, or on the opening where a collar is across. Shoulders
below collars that point up are chamfered at 45 degrees; collars that point sideways have no lower
wall and are cut off at 45 degrees. So nothing hangs over but the upper edges of windows, which
printers bridge, and half a wall below the collars that point sideways. After section 3.5.1 of the
thesis, which does not describe its joints.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold

from skylight.probes.fabrication._parts import PrintedPart, PrintSizes, box, part_of
from skylight.probes.voxel._model import NORMALS, VoxelModel
from skylight.probes.voxel._press_fit import (
    COLLAR,
    DOWN,
    FLUSH,
    OPEN,
    PressFit,
    cell_sides,
    collar_bounds,
    opposite,
    plan_press_fit,
    shrunk,
)


@dataclass(frozen=True, kw_only=True)
class VoxelParts:
    """Parts of a model as they stand when assembled, in order of assembly.

    In mm: ``face_mm`` times the model's coordinates, axes as the model's.
    """

    model: VoxelModel
    sizes: PrintSizes
    assembly: PressFit
    parts: tuple[PrintedPart, ...]

    @property
    def mount_lattice(self) -> Float[np.ndarray, "3 2"]:
        """Bounds of the voxel that stands on the pole."""
        cell = self.assembly.cells[0]
        return self.sizes.face_mm * np.stack([cell, cell + 1], -1)

    @cached_property
    def mount_collar(self) -> Float[np.ndarray, "3 2"]:
        """Outer bounds of the collar that the pole's foot needs, to close that voxel below."""
        _, cavity = cell_sides(self.assembly.cells[0], self.assembly.sides[0], self.sizes)
        return collar_bounds(cavity, DOWN, self.sizes)

    @property
    def solid_mm3(self) -> float:
        """Volume of the model were it solid."""
        return len(self.model) * self.sizes.face_mm**3

    @property
    def volume_mm3(self) -> float:
        """Material of the parts."""
        return sum(part.volume_mm3 for part in self.parts)


def voxel_parts(model: VoxelModel, sizes: PrintSizes) -> VoxelParts:
    """Parts that make up a model, as :func:`.plan_press_fit` plans them."""
    assembly = plan_press_fit(model, sizes)
    digits = len(str(len(assembly)))
    parts = tuple(
        _part(assembly, i, sizes, f"part_{i + 1:0{max(2, digits)}d}") for i in range(len(assembly))
    )
    return VoxelParts(model=model, sizes=sizes, assembly=assembly, parts=parts)


def _part(assembly: PressFit, part: int, sizes: PrintSizes, name: str) -> PrintedPart:
    cell, sides = assembly.cells[part], assembly.sides[part]
    outer, cavity = cell_sides(cell, sides, sizes)
    opening = int(assembly.toward_parent[part])
    up = opposite(opening) if sides[opposite(opening)] == COLLAR else opening
    lattice = sizes.face_mm * np.stack([cell, cell + 1], -1).astype(float)
    # past the plane of the opening, so that no film is left there
    cut = cavity.copy()
    cut[opening // 2, 0 if opening % 2 else 1] += sizes.wall_mm * NORMALS[opening].sum()
    solid = _box(outer) - _box(cut)
    for side in np.flatnonzero((sides == COLLAR) | (sides == FLUSH)).tolist():
        solid -= _box(_window(lattice, side, sizes))
    if sides[up] == COLLAR:
        solid += _chamfer(cavity, lattice, up, sizes)
    for child in assembly.children(part):
        _, there = cell_sides(assembly.cells[child], assembly.sides[child], sizes)
        toward = int(assembly.toward_parent[child])
        solid += collar(collar_bounds(there, toward, sizes), opposite(toward), up, sizes)
    assert sides[opening] == OPEN
    x, y, z = NORMALS[up].tolist()
    return part_of(name, solid, (x, y, z))


def collar(bounds: Float[np.ndarray, "3 2"], outward: int, up: int, sizes: PrintSizes) -> Manifold:
    """A square tube with these outer bounds, rooted one wall deep in the part that carries it.

    Where it does not point up it has no lower wall and is cut off at 45 degrees below, from half
    a wall in front of its root: that much prints without support, and holds the next part up.
    """
    axis, sign = outward // 2, int(NORMALS[outward].sum())
    wall = sizes.wall_mm
    along = np.zeros(6)
    along[outward] = along[opposite(outward)] = -wall
    inner = shrunk(bounds, np.where(along < 0, along, wall))
    root = bounds.copy()
    start = 0 if sign > 0 else 1  # of the two ends, the one at the carrying part
    root[axis, start] -= sign * wall
    inner[axis, start] -= sign * wall
    if outward == up:
        return _box(root) - _box(inner)
    down = opposite(up)
    below = np.zeros(6)
    below[down] = -2 * wall
    # the root lies within the carrying part's wall, which closes it below
    tube = _box(root) - _box(shrunk(inner, below))
    corner = np.zeros(3)
    corner[axis] = bounds[axis, start]
    corner[up // 2] = bounds[up // 2, 0 if up % 2 == 0 else 1]
    slope = (NORMALS[up] - NORMALS[outward]) / np.sqrt(2.0)
    land = wall / 2 / np.sqrt(2.0)
    return tube.trim_by_plane(tuple(slope), float(slope @ corner - land))


def _window(lattice: np.ndarray, side: int, sizes: PrintSizes) -> np.ndarray:
    """What is cut out of a side that another part covers."""
    amounts = np.full(6, sizes.frame_mm)
    amounts[side] = -sizes.wall_mm
    amounts[opposite(side)] = sizes.face_mm - 2 * sizes.wall_mm
    return shrunk(lattice, amounts)


def _chamfer(cavity: np.ndarray, lattice: np.ndarray, up: int, sizes: PrintSizes) -> Manifold:
    """What lets the frame around an upper window grow from the walls at 45 degrees."""
    axis, sign = up // 2, int(NORMALS[up].sum())
    ceiling = cavity[axis, 1 if sign > 0 else 0]
    deep = sizes.frame_mm - sizes.wall_mm
    half = sizes.wall_mm / 2  # into the walls and the ceiling
    amounts = np.full(6, -half)
    block = shrunk(cavity, amounts)
    block[axis] = sorted([ceiling + sign * half, ceiling - sign * deep])
    window = shrunk(lattice, sizes.frame_mm)
    shaft = window.copy()
    shaft[axis] = sorted([ceiling - sign * deep, ceiling + sign * sizes.wall_mm])
    points = []
    for height in (0.0, deep):  # below the ceiling
        grown = shrunk(window, -height)
        grown[axis] = ceiling - sign * height
        points += [
            [grown[0, i], grown[1, j], grown[2, k]] for i in (0, 1) for j in (0, 1) for k in (0, 1)
        ]
    return _box(block) - Manifold.hull_points(np.array(points)) - _box(shaft)


def _box(bounds: np.ndarray) -> Manifold:
    return box(bounds[:, 0].astype(float), bounds[:, 1].astype(float))
