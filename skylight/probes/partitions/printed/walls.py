"""The walls of a partition probe as solids, in millimetres about the probe's centre.

A face's centre stands ``kernel_mm`` before the point where the planes of its walls meet. So, past
the outer ends of thin walls, it sees directions of neighbouring cells. Were a wall as thick as
twice the centre's distance from its plane, the centre would see its own cell alone: its cell's
cone, moved to the centre, would just touch the wall. Only the walls' outer ends need that
thickness. Rims stay narrower by what lets a disc about the centre see the whole cell, too.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold, Mesh64

from skylight.probes.partitions.printed.sizes import SEEN_DISC, ProbeSizes
from skylight.probes.partitions.printed.solids import WallNet, along_axis, face_radii

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

    Raises
    ------
    InputError
        A cell is too narrow for its walls.
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
) -> Manifold:
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
) -> Manifold:
    """The solid between two sheets, each a tip and arcs of ``count`` points, anticlockwise."""
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
) -> list[Manifold]:
    """Round edges where walls leave more than half a turn open, as at the bends of merged cells.

    Cones, at the rim as wide as the narrowest side of the walls that meet there.
    """
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
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    along = np.cross(axis, across)
    angle = np.sort(np.arctan2(others @ along, others @ across))
    return float(np.diff([*angle, angle[0] + 2 * np.pi]).max())
