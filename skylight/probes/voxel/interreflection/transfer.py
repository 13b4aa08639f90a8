"""Transfer vectors of all lightmap slots: their radiance under each spherical harmonic.

Thesis, section 3.4.4 (Eq. 3.15 and 3.16), globally illuminated: the simplest geometry that gives
a face its configuration, Lambertian of one albedo, is lit by each harmonic.
"""

from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.voxel.faces import FORWARD, NORMALS, ORIENTATIONS, RIGHT
from skylight.probes.voxel.interreflection.cell_radiosity import CellTransfer
from skylight.sphere.rotation import rotate

DEGREE = 4  # 25 harmonics
SIZE = 16


def transfer_vectors(
    albedo: float, *, size: int = SIZE, degree: int = DEGREE
) -> Float[Tensor, "6 32 n n k"]:
    """t of each texel centre of each slot, float64: radiance is ``t @ coefficients of the light``.

    Light is in the world's harmonics. Orientations differ by rotations of the basis alone, which
    are exact. Error: see :func:`slot_transfer`.
    """
    local = slot_transfer(albedo, size=size, degree=degree)
    # what a face receives of Y_i(R^T w) is what the world's light Y_i sends after D(R)
    return torch.stack([rotate(local, face_frame(o)) for o in range(len(ORIENTATIONS))])


def slot_transfer(
    albedo: float | Float[Tensor, ""], *, size: int = SIZE, degree: int = DEGREE
) -> Float[Tensor, "32 n n k"]:
    """:func:`transfer_vectors` for harmonics of the face's frame (right, forward, normal).

    Relative error of a slot's vector against 16 x 16 polynomials: 3e-4 at most for an albedo of
    1, less for darker ones. It takes a second or two, and is cached but where the albedo needs a
    gradient.
    """
    if not 0 <= albedo <= 1:
        raise InputError(f"an albedo lies in 0 to 1, got {float(albedo):g}")
    if size < 1 or degree < 0:
        raise InputError(f"size must be 1 or more and degree 0 or more, got {size} and {degree}")
    if isinstance(albedo, Tensor) and albedo.requires_grad and torch.is_grad_enabled():
        return _cell_transfer(size, degree).at(albedo).unflatten(1, (size, size))
    return _cached_transfer(float(albedo), size, degree).clone()


@lru_cache(maxsize=8)
def _cached_transfer(albedo: float, size: int, degree: int) -> Tensor:
    return _cell_transfer(size, degree).at(albedo).unflatten(1, (size, size))


@lru_cache(maxsize=4)
def _cell_transfer(size: int, degree: int) -> CellTransfer:
    along = (torch.arange(size, dtype=torch.float64) + 0.5) / size
    # row 0 lies forward, column 0 left
    forward, right = torch.meshgrid(along.flip(0), along, indexing="ij")
    return CellTransfer(torch.stack([right, forward], -1).reshape(-1, 2), degree)


def face_frame(orientation: int) -> Float[Tensor, "3 3"]:
    """Columns: where right, forward and the normal of a face point in the world."""
    axes = np.stack([RIGHT[orientation], FORWARD[orientation], NORMALS[orientation]], 1)
    return torch.from_numpy(axes).double()
