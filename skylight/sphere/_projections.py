"""Projections of the sphere, to and from lat-long maps.

Every projection is a picture of unit squares, u to the right and v down, in the world frame of
:mod:`skylight.sphere._frame`:

========== ======= ==============================================================================
name       h : w   what it shows
========== ======= ==============================================================================
latlong    1 : 2   zenith in the first row, -Z in the centre, +X to its right
cube       3 : 4   a horizontal cross: +Y above -Z; -X, -Z, +X, +Z in a row; -Y below -Z
octahedral 1 : 1   +Y in the centre, -Y in the corners, +X right, -Z up (Engelhardt & Dachsbacher
                   2008, "Octahedron environment maps")
angular    1 : 1   -Z in the centre, +Z on the rim; the radius is the angle from -Z over pi
mirrorball 1 : 1   a mirror ball seen from far along -Z: +Z in the centre, -Z on the rim
========== ======= ==============================================================================

The six faces of :func:`cube_faces` have the order and the orientation that graphics libraries read:
OpenGL's (4.6 core, table 8.19), which Direct3D, Vulkan and Metal share, and so ARCore and ARKit.
These are +X, -X, +Y, -Y, +Z, -Z; with s to the right and t downwards, both from -1 to 1, face k
shows the direction c + s r + t d:

==== ======= ======= =======
face c       r       d
==== ======= ======= =======
+X   (1,0,0) -Z      -Y
-X   -X      +Z      -Y
+Y   +Y      +X      +Z
-Y   -Y      +X      -Z
+Z   +Z      +X      -Y
-Z   -Z      -X      -Y
==== ======= ======= =======

Each is the mirror image of what an eye inside the cube sees. Its pixels' solid angles are those of
:func:`skylight.sphere._wavelets.texel_solid_angles`, whose cube map is seen from inside.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight._names import Projection
from skylight.errors import InputError
from skylight.sphere._envmap import EnvironmentMap, bilinear
from skylight.sphere._frame import (
    angles_from_direction,
    direction_from_angles,
    pixel_from_direction,
)

_ASPECTS: dict[Projection, tuple[int, int]] = {
    "latlong": (1, 2),
    "cube": (3, 4),
    "octahedral": (1, 1),
    "angular": (1, 1),
    "mirrorball": (1, 1),
}
# of the cross: place (row, column), what lies in the face's centre, to its right and down
_FACES = (
    ((0, 1), (0, 1, 0), (1, 0, 0), (0, 0, -1)),
    ((1, 0), (-1, 0, 0), (0, 0, -1), (0, -1, 0)),
    ((1, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0)),
    ((1, 2), (1, 0, 0), (0, 0, 1), (0, -1, 0)),
    ((1, 3), (0, 0, 1), (-1, 0, 0), (0, -1, 0)),
    ((2, 1), (0, -1, 0), (1, 0, 0), (0, 0, 1)),
)
MOST_LOOKUPS = 1 << 21  # at a time: bounds the scratch memory to some 300 MB


@dataclass(frozen=True, kw_only=True)
class Seen:
    """Where points of a picture look (n,3), the solid angle per area there, and which look at all.

    ``density`` is dw over the area of the picture in units of its height squared.
    """

    directions: Float[Tensor, "n 3"]
    density: Float[Tensor, " n"]
    inside: Bool[Tensor, " n"]


def shape(projection: Projection, height: int) -> tuple[int, int]:
    """(rows, columns) of a picture of ``height`` rows."""
    if projection not in _ASPECTS:
        raise InputError(f"unknown projection {projection!r}: choose one of {', '.join(_ASPECTS)}")
    rows, columns = _ASPECTS[projection]
    if height < 2 or height % rows or (projection == "latlong" and height % 2):
        raise InputError(f"a picture of kind {projection} cannot have {height} rows")
    return height, height // rows * columns


def looks(projection: Projection, u: Float[Tensor, " n"], v: Float[Tensor, " n"]) -> Seen:
    """The directions seen at (u, v), right and down, both from 0 to 1 over the picture."""
    if projection == "cube":
        return _looks_cube(u, v)
    if projection == "octahedral":
        return _looks_octahedral(2 * u - 1, 1 - 2 * v)
    if projection == "latlong":
        zenith = v * math.pi
        return Seen(
            directions=direction_from_angles((u - 0.5) * 2 * math.pi, zenith),
            density=math.pi**2 * torch.sin(zenith),
            inside=torch.ones_like(u, dtype=torch.bool),
        )
    x, y = 2 * u - 1, 1 - 2 * v
    radius = torch.hypot(x, y)
    inside = radius <= 1
    held = radius.clamp(max=1)
    if projection == "angular":
        angle = math.pi * held  # from -Z
        density = 4 * math.pi**2 * torch.sinc(held)
        forward = -torch.cos(angle)
    else:
        angle = 2 * torch.asin(held)  # from +Z, which the centre reflects
        density = torch.full_like(held, 16.0)
        forward = torch.cos(angle)
    across = torch.sin(angle) / radius.clamp(min=1e-12)
    return Seen(
        directions=torch.stack([across * x, across * y, forward], 1), density=density, inside=inside
    )


def places(
    projection: Projection, directions: Float[Tensor, "n 3"]
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """(u, v) of unit vectors: the inverse of :func:`looks`."""
    x, y, z = directions.unbind(1)
    if projection == "latlong":
        azimuth, zenith = angles_from_direction(directions)
        return azimuth / (2 * math.pi) + 0.5, zenith / math.pi
    if projection == "cube":
        return _places_cube(directions)
    if projection == "octahedral":
        total = x.abs() + y.abs() + z.abs()
        p, q = x / total, -z / total
        fold = y < 0
        p, q = (
            torch.where(fold, (1 - q.abs()) * _sign(p), p),
            torch.where(fold, (1 - p.abs()) * _sign(q), q),
        )
        return (p + 1) / 2, (1 - q) / 2
    across = torch.hypot(x, y)
    if projection == "angular":
        radius = torch.atan2(across, -z) / math.pi
    else:
        radius = torch.sin(torch.atan2(across, z) / 2)
    scale = radius / across.clamp(min=1e-12)
    return (scale * x + 1) / 2, (1 - scale * y) / 2


def from_latlong(
    environment: EnvironmentMap, projection: Projection, height: int
) -> Float[Tensor, "h w 3"]:
    """A full lat-long map as another picture of the sphere; black where that shows nothing.

    Every pixel is the mean of look-ups by solid angle, at least two per source pixel in each
    direction. Energy is kept to 1 % for smooth light and to about 10 % for a sun of one pixel.
    """
    rows, columns = shape(projection, height)
    if environment.is_sky:
        raise InputError("a sky alone has no lower half: give a full lat-long map")

    def value(directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        return bilinear(
            environment.radiance, *pixel_from_direction(directions, *environment.layout)
        )

    # the picture spans 180 degrees or more over its height
    per_pixel = max(2, math.ceil(2 * environment.layout[0] / rows))
    return _averaged(projection, (rows, columns), per_pixel, value).to(environment.radiance)


def to_latlong(
    picture: Float[Tensor, "h w 3"], projection: Projection, height: int
) -> EnvironmentMap:
    """A lat-long map of ``height`` rows from another picture of the sphere, by the nearest pixels.

    Every pixel is the mean of look-ups by solid angle, at least two per pixel of the picture.

    Raises
    ------
    InputError
        The picture has not the projection's shape.
    """
    rows, columns = picture.shape[:2]
    if shape(projection, rows) != (rows, columns):
        wanted = shape(projection, rows)[1]
        raise InputError(
            f"a picture of kind {projection} with {rows} rows has {wanted} columns, not {columns}"
        )
    shape("latlong", height)

    def value(directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        right, down = places(projection, directions)
        row = (down * rows).long().clamp(0, rows - 1)
        return picture[row, (right * columns).long().clamp(0, columns - 1)]

    per_pixel = max(2, math.ceil(2 * rows / height))
    size = (height, 2 * height)
    return EnvironmentMap(radiance=_averaged("latlong", size, per_pixel, value).to(picture))


def _averaged(
    projection: Projection,
    size: tuple[int, int],
    per_pixel: int,
    value: Callable[[Float[Tensor, "n 3"]], Float[Tensor, "n 3"]],
) -> Float[Tensor, "h w 3"]:
    """A picture of ``value`` over directions, each pixel the mean of ``per_pixel``^2 of them."""
    rows, columns = size
    picture = torch.zeros(rows, columns, 3, dtype=torch.float64)
    block = max(1, MOST_LOOKUPS // (columns * per_pixel**2))
    for first in range(0, rows, block):
        last = min(first + block, rows)
        v, u = torch.meshgrid(
            (torch.arange(first * per_pixel, last * per_pixel).double() + 0.5) / (rows * per_pixel),
            (torch.arange(columns * per_pixel).double() + 0.5) / (columns * per_pixel),
            indexing="ij",
        )
        seen = looks(projection, u.flatten(), v.flatten())
        weight = (seen.density * seen.inside)[:, None]
        sums = torch.cat([value(seen.directions).double() * weight, weight], 1)
        blocks = sums.unflatten(0, (last - first, per_pixel, columns, per_pixel)).sum((1, 3))
        picture[first:last] = blocks[..., :3] / blocks[..., 3:].clamp(min=1e-12)
    return picture


def _sign(x: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """1 for zero, so that a fold has two sides."""
    return torch.where(x < 0, -1.0, 1.0).to(x)


def _looks_octahedral(x: Float[Tensor, " n"], y: Float[Tensor, " n"]) -> Seen:
    """(x, y) in [-1, 1], right and up."""
    height = 1 - x.abs() - y.abs()
    fold = height < 0
    p = torch.where(fold, (1 - y.abs()) * _sign(x), x)
    q = torch.where(fold, (1 - x.abs()) * _sign(y), y)
    point = torch.stack([p, height, -q], 1)
    length = point.norm(dim=1)
    # |p|_1 = 1: a face's plane is 1 / sqrt 3 away and leans, so that dw = dx dy / |p|^3
    return Seen(
        directions=point / length[:, None],
        density=4 / length**3,
        inside=torch.ones_like(fold),
    )


def _looks_cube(u: Float[Tensor, " n"], v: Float[Tensor, " n"]) -> Seen:
    across, down = 4 * u, 3 * v
    column, row = across.long().clamp(0, 3), down.long().clamp(0, 2)
    x, y = 2 * (across - column) - 1, 2 * (down - row) - 1
    directions = torch.stack([torch.zeros_like(x)] * 3, 1)
    inside = torch.zeros_like(x, dtype=torch.bool)
    for (face_row, face_column), *axes in _FACES:
        here = (row == face_row) & (column == face_column)
        centre, right, below = (torch.tensor(axis).to(x) for axis in axes)
        inside |= here
        directions[here] = centre + x[here, None] * right + y[here, None] * below
    length = directions.norm(dim=1).clamp(min=1)
    # a face is a third of the picture high and 2 wide in x and y
    return Seen(directions=directions / length[:, None], density=36 / length**3, inside=inside)


def _places_cube(
    directions: Float[Tensor, "n 3"],
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    u, v = torch.zeros_like(directions[:, 0]), torch.zeros_like(directions[:, 0])
    largest = directions.abs().amax(1)
    for (row, column), *axes in _FACES:
        centre, right, below = (torch.tensor(axis).to(directions) for axis in axes)
        ahead = directions @ centre
        here = ahead >= largest * (1 - 1e-12)
        # of the edge between two faces the last one wins
        u[here] = (column + ((directions[here] @ right) / ahead[here] + 1) / 2) / 4
        v[here] = (row + ((directions[here] @ below) / ahead[here] + 1) / 2) / 3
    return u, v


FACES = ("px", "nx", "py", "ny", "pz", "nz")
_X, _Y, _Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
_NX, _NY, _NZ = (-1, 0, 0), (0, -1, 0), (0, 0, -1)
_AXES = (
    (_X, _NZ, _NY), (_NX, _Z, _NY), (_Y, _X, _Z), (_NY, _X, _NZ), (_Z, _X, _NY), (_NZ, _NX, _NY)
)  # fmt: skip
# where each face lies in skylight's cross, and whether it is turned there by half a turn more
_IN_CROSS = ((1, 2, False), (1, 0, False), (0, 1, True), (2, 1, True), (1, 3, False), (1, 1, False))


def cube_faces(environment: EnvironmentMap, size: int) -> Float[Tensor, "6 s s 3"]:
    """A full lat-long map as six faces of ``size`` pixels a side.

    Each pixel is a mean by solid angle; how well energy is kept is said at
    :func:`skylight.sphere._projections.from_latlong`.

    Raises
    ------
    InputError
        A sky alone, or a face of no pixels.
    """
    cross = from_latlong(environment, "cube", 3 * size)
    faces = []
    for row, column, turned in _IN_CROSS:
        seen = cross[row * size : (row + 1) * size, column * size : (column + 1) * size]
        # the cross is seen from inside: mirrored left to right it is OpenGL's
        faces.append(seen.flip(0) if turned else seen.flip(1))
    return torch.stack(faces)


def face_directions(size: int) -> Float[Tensor, "6 s s 3"]:
    """Unit vectors of the pixels' centres, float64, as in the table above."""
    edge = (torch.arange(size, dtype=torch.float64) + 0.5) / size * 2 - 1
    t, s = torch.meshgrid(edge, edge, indexing="ij")
    faces = []
    for axes in _AXES:
        c, r, d = (torch.tensor(axis, dtype=torch.float64) for axis in axes)
        faces.append(c + s[..., None] * r + t[..., None] * d)
    return torch.nn.functional.normalize(torch.stack(faces), dim=-1)
