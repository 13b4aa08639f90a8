"""A partition probe's sizes, its net of walls and its kernel, in mm about the probe's centre.

The outer shell is nothing but the walls between cells, about the planes through the centre that
bound the cells. Walls end flat above the kernel's edges, at right angles to their own plane, so
that nothing is thinner than they are.

A face's centre stands ``kernel_mm`` before the point where the planes of its walls meet. So, past
the outer ends of thin walls, it sees directions of neighbouring cells. Were a wall as thick as
twice the centre's distance from its plane, the centre would see its own cell alone: its cell's
cone, moved to the centre, would just touch the wall. Only the walls' outer ends need that
thickness. Rims stay narrower by what lets a disc about the centre see the whole cell, too.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from skylight.errors import InputError
from skylight.probes.partitions._cells import Cells

if TYPE_CHECKING:
    from manifold3d import Manifold

NOZZLE_MM = 0.4  # the common one
# of a face's free radius: how far round its centre captures look at it
SEEN_DISC = 0.75
_LEAST_SHELL_MM = 5.0  # from the kernel's faces to the outside


@dataclass(frozen=True, kw_only=True)
class ProbeSizes:
    """Diameter of the shell, distance of the kernel's faces from its centre, and fits; mm.

    ``wall_mm`` is the thickness of the walls between cells, ``clearance_mm`` the gap per side
    between parts that meet. ``flare``: walls grow thicker outwards, from 0, not at all, to 1, as
    far as hides nothing of a cell's light from a disc of ``SEEN_DISC`` of its face's free radius
    (:func:`~skylight.probes.partitions.printed._solids.rim_halves`).
    """

    outer_mm: float = 80.0
    kernel_mm: float = 8.0
    wall_mm: float = 1.6
    clearance_mm: float = 0.15
    flare: float = 0.0  # of probes whose files do not say

    def __post_init__(self) -> None:
        for name in ("outer_mm", "kernel_mm", "wall_mm", "clearance_mm"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"{name} must be a length above 0 mm, got {value:g}")
        if not 0 <= self.flare <= 1:
            raise InputError(f"flare must be 0 to 1, got {self.flare:g}")
        if self.clearance_mm >= self.wall_mm / 2:
            raise InputError(
                f"clearance_mm {self.clearance_mm:g} must be below half of wall_mm "
                f"{self.wall_mm:g}, or light passes below the walls; 0.1 to 0.3 suits most printers"
            )
        if self.wall_mm < 2 * NOZZLE_MM:
            raise InputError(
                f"walls of {self.wall_mm:g} mm are too thin to print: make wall_mm "
                f"{2 * NOZZLE_MM:g} or more (two lines of a {NOZZLE_MM:g} mm nozzle)"
            )
        if self.radius_mm < self.kernel_mm + _LEAST_SHELL_MM:
            raise InputError(
                f"a kernel with faces {self.kernel_mm:g} mm from its centre leaves no room for "
                f"walls in a shell of {self.outer_mm:g} mm: make outer_mm "
                f"{2 * (self.kernel_mm + _LEAST_SHELL_MM):g} or more, or the kernel smaller"
            )

    @property
    def radius_mm(self) -> float:
        """Of the shell."""
        return self.outer_mm / 2


_LEAST_OPENING_MM = 2 * NOZZLE_MM  # a narrower gap closes when printed
_LEAST_WALL_DEPTH_MM = 4.0
_FLAT_RAD = math.radians(25.0)  # faces are flat that far / 2 at least, seen from the centre
_STEEPEST_RAD, _DIRECTIONS = math.radians(80.0), 321


@dataclass(frozen=True, kw_only=True)
class WallNet:
    """Walls between different cells: arcs from vertex ``starts[k]`` to ``ends[k]``.

    ``poles`` (e,3) are the unit normals of their planes, towards cell ``left[k]``; ``normals``
    (n,3) those of the kernel's faces, ``merged_seeds`` (m,3) the seeds of cells ``merged_cells``
    that have more than one.
    """

    vertices: Float[np.ndarray, "v 3"]
    starts: Int[np.ndarray, " e"]
    ends: Int[np.ndarray, " e"]
    left: Int[np.ndarray, " e"]
    right: Int[np.ndarray, " e"]
    poles: Float[np.ndarray, "e 3"]
    normals: Float[np.ndarray, "n 3"]
    merged_seeds: Float[np.ndarray, "m 3"]
    merged_cells: Int[np.ndarray, " m"]

    @staticmethod
    def of(cells: Cells, rotation: Float[np.ndarray, "3 3"] | None = None) -> "WallNet":
        """The walls of a design, turned to ``rotation @ x``."""
        turn = np.eye(3) if rotation is None else rotation
        t, label = cells.tessellation, cells.design.labels.numpy()
        left, right = label[t.left.numpy()], label[t.right.numpy()]
        wall = left != right
        several = np.bincount(label)[label] > 1
        return WallNet(
            vertices=t.vertices.numpy() @ turn.T,
            starts=t.starts.numpy()[wall],
            ends=t.ends.numpy()[wall],
            left=left[wall],
            right=right[wall],
            poles=t.poles.numpy()[wall] @ turn.T,
            normals=cells.normals.numpy() @ turn.T,
            merged_seeds=cells.design.seeds.numpy()[several] @ turn.T,
            merged_cells=label[several],
        )

    @property
    def ends_of_walls(self) -> Float[np.ndarray, "e 2 3"]:
        """Unit directions of both ends of each wall."""
        return np.stack([self.vertices[self.starts], self.vertices[self.ends]], 1)

    @property
    def middles(self) -> Float[np.ndarray, "e 3"]:
        """Unit directions halfway along the walls."""
        middle = self.ends_of_walls.sum(1)
        return middle / np.linalg.norm(middle, axis=1, keepdims=True)

    @property
    def lengths_rad(self) -> Float[np.ndarray, " e"]:
        a, b = self.ends_of_walls.transpose(1, 0, 2)
        return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(1))

    @property
    def meeting(self) -> Int[np.ndarray, " v"]:
        """How many walls meet at each vertex."""
        return np.bincount(np.concatenate([self.starts, self.ends]), minlength=len(self.vertices))


def face_radii(net: WallNet, sizes: ProbeSizes) -> Float[np.ndarray, " n"]:
    """How far round its centre each face is flat and free of walls, mm.

    Refuses cells too narrow for their walls, which meet or leave less than a printer can keep open.
    """
    centres = sizes.kernel_mm * net.normals
    walls = np.full(len(centres), np.inf)
    for side in (net.left, net.right):
        np.minimum.at(walls, side, sector_distance(centres[side], net.ends_of_walls, net.poles))
    narrow = int(walls.argmin())
    opening = 2 * walls[narrow] - sizes.wall_mm
    if opening < _LEAST_OPENING_MM:
        needed = sizes.kernel_mm * (_LEAST_OPENING_MM + sizes.wall_mm) / (2 * walls[narrow])
        found = (
            "close it"
            if opening <= 0
            else f"leave {opening:.2f} mm of it open, less than a nozzle can"
        )
        raise InputError(
            f"cell {narrow} is too narrow: above the kernel its walls {found}; make kernel_mm "
            f"{math.ceil(10 * needed) / 10:g} or more, and outer_mm with it, or the walls thinner"
        )
    planes = kernel_planes(net)
    # tangent planes at angle t to each other meet tan(t / 2) from where they touch
    cosine = np.clip(net.normals @ planes.T, -1, 1)
    cosine[np.arange(len(cosine)), np.arange(len(cosine))] = -1
    flat = sizes.kernel_mm * np.tan(np.arccos(cosine.max(1)) / 2)
    return np.minimum(flat, walls - sizes.wall_mm / 2)


def kernel_planes(net: WallNet) -> Float[np.ndarray, "k 3"]:
    """Unit normals of the planes that bound the kernel; the first n are the faces'.

    The others are those of seeds of merged cells, without which such a cell's plane would run far
    out; seeds that would cut into the middle of the cell's own face are left out.
    """
    own = (net.merged_seeds * net.normals[net.merged_cells]).sum(1)
    away = np.arccos(np.clip(own, -1, 1))
    return np.concatenate([net.normals, net.merged_seeds[away > _FLAT_RAD]])


def kernel_solid(net: WallNet, sizes: ProbeSizes) -> "Manifold":
    """The polyhedron whose faces touch the ball of radius ``kernel_mm``.

    Where every cell has one seed, this is the union of {x in cell i's cone, <x, n_i> <=
    kernel_mm} (thesis, section 4.7); for merged cells it leaves out the steps between such cones.
    """
    planes = kernel_planes(net)
    solid = bounded(planes, np.full(len(planes), sizes.kernel_mm))
    reach = float(np.linalg.norm(corners_of(solid), axis=1).max())
    if reach > sizes.radius_mm - _LEAST_WALL_DEPTH_MM:
        raise InputError(
            f"the kernel's corners are {reach:.1f} mm from the centre and leave no walls in a "
            f"shell of {sizes.outer_mm:g} mm: make outer_mm "
            f"{math.ceil(2 * (reach + _LEAST_WALL_DEPTH_MM)):g} or more, or kernel_mm smaller"
        )
    return solid


def corners_of(solid: "Manifold") -> Float[np.ndarray, "v 3"]:
    """Vertices of a solid."""
    return np.array(solid.to_mesh64().vert_properties, np.float64)[:, :3]


def bounded(normals: Float[np.ndarray, "k 3"], offsets: Float[np.ndarray, " k"]) -> "Manifold":
    """{x: <x, normals_k> <= offsets_k}, within a cube of 2 m."""
    from manifold3d import Manifold

    solid = Manifold.cube((2e3, 2e3, 2e3), True)
    for normal, offset in zip(normals, offsets, strict=True):
        solid = solid.trim_by_plane(tuple((-normal).tolist()), -float(offset))
    return solid


@dataclass(frozen=True, kw_only=True)
class WallEnds:
    """Planes that touch the kernel, at right angles to each wall: where the wall could end.

    ``normals`` (e,d,3) point up the wall, ``heights`` (e,d) are where they cross its middle:
    h(n) / <n, middle>, h the kernel's reach along n, mm.
    """

    net: WallNet
    kernel: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "e d 3"]
    heights: Float[np.ndarray, "e d"]

    @staticmethod
    def of(net: WallNet, kernel: Float[np.ndarray, "v 3"]) -> "WallEnds":
        """For a kernel with these corners."""
        angle = np.linspace(-_STEEPEST_RAD, _STEEPEST_RAD, _DIRECTIONS)[:, None]
        across = np.cross(net.poles, net.middles)[:, None]
        grid = np.cos(angle) * net.middles[:, None] + np.sin(angle) * across
        # those of single seeds fit exactly
        own = np.stack([net.normals[net.left], net.normals[net.right]], 1)
        own = own - (own * net.poles[:, None]).sum(-1, keepdims=True) * net.poles[:, None]
        normals = _unit(np.concatenate([grid, own], 1))
        heights = _heights(net, kernel, normals)
        return WallEnds(net=net, kernel=kernel, normals=normals, heights=heights)

    def lowest(
        self, way_in: Float[np.ndarray, "3"] | None = None
    ) -> tuple[Float[np.ndarray, "e 3"], Float[np.ndarray, " e"]]:
        """(normals, heights) that leave each wall the smallest gap.

        With a way in, of those alone that do not stand in the way of a kernel moved along it.
        """
        normals, heights = self.normals, self.heights
        if way_in is not None:
            passing = _unit(np.cross(self.net.poles, way_in))
            both = np.stack([passing, -passing], 1)
            normals = np.concatenate([normals, both], 1)
            heights = np.concatenate([heights, _heights(self.net, self.kernel, both)], 1)
            heights = np.where(normals @ way_in < 1e-9, heights, np.inf)
        best = heights.argmin(1)
        row = np.arange(len(best))
        return normals[row, best], heights[row, best]


def core_solid(ends: WallEnds, clearance_mm: float, way_in: Float[np.ndarray, "3"]) -> "Manifold":
    """What walls keep free: the kernel with its clearance, on its whole way out along ``way_in``.

    Every wall ends in one plane at right angles to its own, so that no edge is sharp.
    """
    normals, heights = ends.lowest(way_in)
    normals = normals[np.isfinite(heights)]
    return bounded(normals, (ends.kernel @ normals.T).max(0) + clearance_mm)


def _heights(
    net: WallNet, kernel: Float[np.ndarray, "v 3"], normals: Float[np.ndarray, "e d 3"]
) -> Float[np.ndarray, "e d"]:
    lean = (normals * net.middles[:, None]).sum(-1)
    pieces = np.array_split(normals, 1 + normals.size // 2**16)
    reach = np.concatenate([(piece @ kernel.T).max(-1) for piece in pieces])
    steep = lean < math.cos(_STEEPEST_RAD) - 1e-9
    return np.where(steep, np.inf, reach / np.where(steep, 1.0, lean))


def _unit(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def frame_along(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Rows: two unit vectors across a unit axis, then the axis; right-handed."""
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    across = across / np.linalg.norm(across)
    return np.stack([across, np.cross(axis, across), axis])


def along_axis(solid: "Manifold", axis: Float[np.ndarray, "3"]) -> "Manifold":
    """Turned so that its +Z points along a unit vector."""
    return solid.transform(np.concatenate([frame_along(axis).T, np.zeros((3, 1))], 1))


def sector_distance(
    points: Float[np.ndarray, "e 3"],
    ends: Float[np.ndarray, "e 2 3"],
    poles: Float[np.ndarray, "e 3"],
) -> Float[np.ndarray, " e"]:
    """Distance of each point from the flat sector between two directions from the origin."""
    a, b = ends[:, 0], ends[:, 1]
    between = ((np.cross(a, points) * poles).sum(1) >= 0) & (
        (np.cross(points, b) * poles).sum(1) >= 0
    )
    rays = [
        np.linalg.norm(points - np.maximum((points * e).sum(1), 0)[:, None] * e, axis=1)
        for e in (a, b)
    ]
    return np.where(between, np.abs((points * poles).sum(1)), np.minimum(*rays))


_RIM_STEP_RAD = math.radians(2.0)
_ROUND = 48  # sides of what is round at the bends of walls
_STRAIGHT = 1e-6
_FLARE_FROM = 1.25  # kernel radii from the centre, where walls begin to grow thicker
_FLARED_WALLS = 4.0  # walls' thicknesses, the length of the shortest rim that is widened
_CONVERGENCE = 0.9
_RIM_WALLS = 2.5  # walls from the rim inwards, where they are as thick as there


def rim_halves(net: WallNet, sizes: ProbeSizes) -> Float[np.ndarray, "e 2"]:
    """From each wall's plane to its rim's sides towards the cells ``left`` and ``right``, mm.

    With w half the wall's thickness, p the unit normal of its plane towards the cell, n the
    normal of that cell's face and r the radius of the disc about the face's centre that must see
    the whole cell (``SEEN_DISC`` of the free radius)::

        w + flare * max(0, c (kernel_mm <n, p> - r sqrt(1 - <n, p>^2)) - w)

    The bracket is the distance of the disc from the wall's plane. A camera in that plane sees the
    whole disc past a rim of c = 0.9 of it where it is ten radii of the shell from the centre, or
    farther. Walls whose rims are shorter than four walls' thickness stay thin, or they would stand
    out as thin blades.
    """
    seen = SEEN_DISC * face_radii(net, sizes)
    half = sizes.wall_mm / 2
    cells = np.stack([net.left, net.right], 1)
    sine = (net.normals[cells] * (np.array([[1.0], [-1.0]]) * net.poles[:, None])).sum(2)
    away = sizes.kernel_mm * sine - seen[cells] * np.sqrt(np.maximum(1 - sine**2, 0))
    long = net.lengths_rad * sizes.radius_mm >= _FLARED_WALLS * sizes.wall_mm
    return half + sizes.flare * np.where(
        long[:, None], np.maximum(_CONVERGENCE * away - half, 0), 0.0
    )


def wall_solid(
    ends: Float[np.ndarray, "2 3"],
    pole: Float[np.ndarray, "3"],
    rim: Float[np.ndarray, "2"],
    sizes: ProbeSizes,
) -> "Manifold":
    """A wall from the centre to the shell's radius, square at both directions and at its rim.

    ``rim``: from the wall's plane to the rim's side along ``pole``, and to the opposite one.
    """
    a, b = ends
    angle = math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))
    # level near both ends, where it meets the rims of others
    flat = min(math.atan2(2 * float(rim.max()), sizes.radius_mm), angle / 2)
    round_from, round_to = 2 * flat, angle - 2 * flat
    arc = np.linspace(round_from, round_to, 2 + int(angle / _RIM_STEP_RAD))
    bends = [0.0, flat, *(arc if round_from < round_to else []), angle - flat, angle]
    at = np.unique(np.round(bends, 12))
    reach = np.full(len(at), sizes.radius_mm)
    reach[[1, -2]] /= math.cos(flat)
    ways = np.cos(at)[:, None] * a + np.sin(at)[:, None] * np.cross(pole, a)
    half, neck = sizes.wall_mm / 2, sizes.radius_mm - _RIM_WALLS * sizes.wall_mm
    inner = min(_FLARE_FROM * sizes.kernel_mm, neck - half)
    sheet = [np.zeros((1, 3)), inner * ways, neck * ways, reach[:, None] * ways]
    upper, lower = (
        np.concatenate([part + z * pole for part, z in zip(sheet, away, strict=True)])
        for away in ((half, half, rim[0], rim[0]), (-half, -half, -rim[1], -rim[1]))
    )
    return _between(upper, lower, len(at))


def _between(
    upper: Float[np.ndarray, "v 3"], lower: Float[np.ndarray, "v 3"], count: int
) -> "Manifold":
    """The solid between two sheets, each a tip and arcs of ``count`` points, anticlockwise."""
    from manifold3d import Manifold, Mesh64

    below = len(upper)
    arcs = np.arange(1, below).reshape(-1, count)
    fan = np.stack([np.zeros(count - 1, int), arcs[0, :-1], arcs[0, 1:]], 1)
    bands = [_quads(near[:-1], far[:-1], far[1:], near[1:]) for near, far in pairwise(arcs)]
    sheet = np.concatenate([fan, *bands])
    outline = np.array([0, *arcs[:-1, 0], *arcs[-1], *arcs[:-1, -1][::-1]])
    onward = np.roll(outline, -1)
    sides = _quads(outline, outline + below, onward + below, onward)
    faces = np.concatenate([sheet, sheet[:, ::-1] + below, sides])
    vertices = np.concatenate([upper, lower])
    return Manifold(Mesh64(vert_properties=vertices, tri_verts=faces.astype(np.uint64)))


def _quads(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def bend_solids(
    net: WallNet,
    vertices: Sequence[int],
    rims: Float[np.ndarray, "e 2"],
    sizes: ProbeSizes,
) -> list["Manifold"]:
    """Round edges where walls leave more than half a turn open, as at the bends of merged cells.

    Cones, at the rim as wide as the narrowest side of the walls that meet there.
    """
    from manifold3d import Manifold

    found = []
    for vertex in vertices:
        axis = net.vertices[vertex]
        there = (net.starts == vertex) | (net.ends == vertex)
        other = np.where(net.starts == vertex, net.ends, net.starts)[there]
        if len(other) and _widest_gap(axis, net.vertices[other]) > np.pi + _STRAIGHT:
            circumscribed = 1 / np.cos(np.pi / _ROUND)
            thin = sizes.wall_mm / 2 * circumscribed
            wide = float(rims[there].min()) * circumscribed
            rod = Manifold.cylinder(sizes.radius_mm, thin, wide, _ROUND)
            found.append(along_axis(rod, axis))
    return found


def _widest_gap(axis: np.ndarray, others: np.ndarray) -> float:
    across, along, _ = frame_along(axis)
    angle = np.sort(np.arctan2(others @ along, others @ across))
    return float(np.diff([*angle, angle[0] + 2 * np.pi]).max())
