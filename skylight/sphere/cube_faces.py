"""The six pictures of a cube map, in the order and the orientation that graphics libraries read.

OpenGL's (4.6 core, table 8.19), which Direct3D, Vulkan and Metal share, and so ARCore and ARKit:
+X, -X, +Y, -Y, +Z, -Z; with s to the right and t downwards, both from -1 to 1, face k shows the
direction c + s r + t d:

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
:func:`skylight.sphere.wavelets.texel_solid_angles`, whose cube map is seen from inside.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.projections import from_latlong

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
    :func:`skylight.sphere.projections.from_latlong`.

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
