"""Cube maps as six pictures, and how these lie in crosses and strips.

The six have the order px, nx, py, ny, pz, nz and show what an eye inside the cube sees, as the
files of three.js' ``CubeTextureLoader``, of DirectX and of game engines do: "positive-x is to the
right when looking up the positive-z axis -- in other words, using a left-handed coordinate system.
Since three.js uses a right-handed coordinate system, environment maps used in three.js will have
pos-x and neg-x swapped" (three.js r184, CubeTextureLoader). So the face *px* shows what lies at -X
of skylight's right-handed frame, which is that of three.js; looked up there, every face shows what
lies in its direction:

==== ========= ======== ======= ===========================
face shows     right    down    in words, for a camera
==== ========= ======== ======= ===========================
px   -X        -Z       -Y      to the left
nx   +X        +Z       -Y      to the right
py   +Y        -X       +Z      above
ny   -Y        -X       -Z      below
pz   +Z        -X       -Y      behind
nz   -Z        +X       -Y      ahead, the middle of the map
==== ========= ======== ======= ===========================

:func:`skylight.sphere._projections.cube_faces` are the same faces without that swap, mirrored as
graphics libraries look them up by directions of a right-handed frame.

============= ======= =====================================================================
layout        h : w   how the faces lie
============= ======= =====================================================================
cube          3 : 4   a horizontal cross, as in :mod:`skylight.sphere._projections`
cube-vertical 4 : 3   a vertical cross: py; px, nz, nx; ny; pz, turned by half a turn
cube-row      1 : 6   a strip, px to nz from left to right
cube-column   6 : 1   a strip, px to nz from above
============= ======= =====================================================================

Nothing is resampled between them.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from skylight._names import CubeLayout
from skylight.errors import InputError

# where each face lies in the horizontal cross, and whether it is turned there by half a turn
_IN_CROSS = ((1, 0, False), (1, 2, False), (0, 1, True), (2, 1, True), (1, 3, False), (1, 1, False))


def faces_of_cross(cross: Float[Tensor, "r c 3"]) -> Float[Tensor, "6 s s 3"]:
    """The six pictures of a horizontal cross."""
    size = cross.shape[0] // 3
    faces = []
    for row, column, turned in _IN_CROSS:
        face = cross[row * size : (row + 1) * size, column * size : (column + 1) * size]
        faces.append(face.flip(0, 1) if turned else face)
    return torch.stack(faces)


def cross_of_faces(faces: Float[Tensor, "6 s s 3"]) -> Float[Tensor, "r c 3"]:
    """The inverse of :func:`faces_of_cross`: black beside the faces."""
    size = faces.shape[1]
    cross = torch.zeros(3 * size, 4 * size, 3, dtype=faces.dtype)
    for face, (row, column, turned) in zip(faces, _IN_CROSS, strict=True):
        place = slice(row * size, (row + 1) * size), slice(column * size, (column + 1) * size)
        cross[place] = face.flip(0, 1) if turned else face
    return cross


def laid_out(cross: Float[Tensor, "r c 3"], layout: CubeLayout) -> Float[Tensor, "h w 3"]:
    """A horizontal cross as one picture of another layout; of six files, the row."""
    if layout == "cube-vertical":
        size = cross.shape[0] // 3
        standing = torch.zeros(4 * size, 3 * size, 3, dtype=cross.dtype)
        standing[: 3 * size] = cross[:, : 3 * size]
        behind = cross[size : 2 * size, 3 * size :]
        standing[3 * size :, size : 2 * size] = behind.flip(0, 1)
        return standing
    faces = faces_of_cross(cross)
    return torch.cat(list(faces), 0 if layout == "cube-column" else 1)


def horizontal_cross(
    picture: Float[Tensor, "h w 3"], layout: CubeLayout | None = None
) -> Float[Tensor, "r c 3"]:
    """The cross that :func:`skylight.sphere._projections.to_latlong` reads, of another layout.

    Without ``layout``, of a cross of either kind.

    Raises
    ------
    InputError
        A picture of another shape.
    """
    height, width = picture.shape[:2]
    told = f"{width}x{height} (width x height)"
    if layout in ("cube-row", "cube-column", "cube-faces"):
        across = layout != "cube-column"
        size = height if across else width
        if (height, width) != ((size, 6 * size) if across else (6 * size, size)):
            shape = "six times as wide as high" if across else "six times as high as wide"
            raise InputError(f"{told} is no {layout} of six square faces: expected {shape}")
        return cross_of_faces(torch.stack(picture.split(size, 1 if across else 0)))
    if 3 * width == 4 * height and layout is None:
        return picture
    size = width // 3
    if (height, width) != (4 * size, 3 * size):
        expected = "4:3 (it lies) or 3:4 (it stands)" if layout is None else "3:4 (it stands)"
        raise InputError(
            f"{told} is no cross of a cube's faces: expected {expected}, of square faces"
        )
    lying = torch.zeros(3 * size, 4 * size, 3, dtype=picture.dtype)
    lying[:, : 3 * size] = picture[: 3 * size]
    lying[size : 2 * size, 3 * size :] = picture[3 * size :, size : 2 * size].flip(0, 1)
    return lying
