"""Transfer vectors of all lightmap slots: how light in harmonics becomes their radiance.

Thesis, section 3.4.4 (Eq. 3.15 and 3.16), globally illuminated: the simplest geometry that gives
a face its configuration, Lambertian of one albedo, is lit by each harmonic.
"""

from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.voxel.cell_radiosity import cell_transfer
from skylight.probes.voxel.faces import (
    CONFIGURATIONS,
    FORWARD,
    NORMALS,
    ORIENTATIONS,
    RIGHT,
    exposed_faces,
    minimal_geometry,
)
from skylight.sphere.rotation import rotate
from skylight.transport.path_tracer import DiffuseScene, Sampling, Traced, radiosity_transfer

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
    return torch.stack([rotate(local, _frame(o)) for o in range(len(ORIENTATIONS))])


def slot_transfer(
    albedo: float, *, size: int = SIZE, degree: int = DEGREE
) -> Float[Tensor, "32 n n k"]:
    """:func:`transfer_vectors` for harmonics of the face's frame (right, forward, normal).

    Relative error of a slot's vector against 16 x 16 polynomials: 3e-4 at most for an albedo of
    1, less for darker ones. It is worked out in a second or two, and kept.
    """
    if not 0 <= albedo <= 1:
        raise InputError(f"an albedo lies in 0 to 1, got {albedo}")
    if size < 1 or degree < 0:
        raise InputError(f"size must be 1 or more and degree 0 or more, got {size} and {degree}")
    return _slot_transfer(albedo, size, degree).clone()


@lru_cache(maxsize=8)
def _slot_transfer(albedo: float, size: int, degree: int) -> Tensor:
    along = (torch.arange(size, dtype=torch.float64) + 0.5) / size
    # row 0 lies forward, column 0 left
    forward, right = torch.meshgrid(along.flip(0), along, indexing="ij")
    points = torch.stack([right, forward], -1).reshape(-1, 2)
    slots = cell_transfer(points, albedo=albedo, degree=degree)
    return slots.reshape(CONFIGURATIONS, size, size, -1)


def traced_slot_transfer(
    configuration: int,
    albedo: float,
    *,
    size: int = SIZE,
    degree: int = DEGREE,
    sampling: Sampling,
    generator: torch.Generator,
) -> Traced:
    """One slot of :func:`slot_transfer` by path tracing its simplest geometry: (n, n, k)."""
    up = ORIENTATIONS.index("+y")
    faces = exposed_faces(minimal_geometry(configuration))
    here = (faces.orientation == up) & (faces.cells == torch.tensor([1, 0, 1])).all(1)
    positions = faces.points(size)[here].reshape(-1, 3)
    normals = torch.from_numpy(NORMALS[up]).double().expand_as(positions)
    traced = radiosity_transfer(
        positions,
        normals,
        DiffuseScene.uniform(*faces.triangles(), albedo),
        degree=degree,
        albedo=albedo,
        sampling=sampling,
        generator=generator,
    )
    # an expansion in the world's harmonics, turned back into the face's frame
    mean = rotate(traced.mean, _frame(up).T)
    # errors of two coefficients are taken as independent
    turn = rotate(torch.eye(mean.shape[1], dtype=torch.float64), _frame(up).T)
    error = (traced.standard_error.square() @ turn.square()).sqrt()
    shape = size, size, mean.shape[1]
    return Traced(mean=mean.reshape(shape), standard_error=error.reshape(shape))


def _frame(orientation: int) -> Float[Tensor, "3 3"]:
    """Columns: where right, forward and the normal of a face point in the world."""
    axes = np.stack([RIGHT[orientation], FORWARD[orientation], NORMALS[orientation]], 1)
    return torch.from_numpy(axes).double()
