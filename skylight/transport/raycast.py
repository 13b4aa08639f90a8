"""Ray casting by embree: closest hits and occlusion."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Int
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class Hits:
    """First hits of r rays; where ``face`` is -1 nothing was hit and the rest is 0 and inf.

    ``barycentric`` weighs the face's three vertices, >= 0 with sum 1; ``distance`` counts
    lengths of the ray's direction vector. Both are float64.
    """

    face: Int[Tensor, " r"]
    barycentric: Float[Tensor, "r 3"]
    distance: Float[Tensor, " r"]


@runtime_checkable
class OcclusionCaster(Protocol):
    """Whether rays hit a mesh: by embree (:class:`Raycaster`), or on another device
    (:class:`~skylight.transport.occlusion.caster.TorchRaycaster`).

    ``epsilon`` is the distance by which a ray's start should be lifted off the surface that it
    leaves, in the mesh's units; ``most_rays`` are as many as should be asked for at once.
    """

    device: torch.device
    epsilon: float
    most_rays: int

    def occluded(
        self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "#r 3"]
    ) -> Bool[Tensor, " r"]:
        """True where a ray hits anything at all; one direction serves all rays where given alone.

        On the device of ``origins``.
        """
        ...


class Raycaster:
    """Ray queries against one triangle mesh, in the mesh's own units; both sides are solid.

    Rays are float32 inside embree. As an :class:`OcclusionCaster` it is the CPU's.
    """

    device = torch.device("cpu")
    most_rays = 2**17  # 6 MB

    def __init__(self, vertices: Float[Tensor, "n 3"], faces: Int[Tensor, "f 3"]) -> None:
        self._corners = checked_corners(vertices, faces)
        self.diagonal = _diagonal(self._corners)
        self.epsilon = lift(self._corners)
        self._scene = EmbreeScene(robust=True)  # no leaks along shared edges
        TriangleMesh(self._scene, _float32(vertices), faces.cpu().numpy().astype(np.int32))
        # The first query builds the acceleration structure: here, before anyone forks.
        self.occluded(torch.zeros(1, 3), torch.ones(1, 3))

    def occluded(
        self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "#r 3"]
    ) -> Bool[Tensor, " r"]:
        """True where a ray hits anything at all; one direction serves all rays where given alone.

        Nothing is copied where both are contiguous float32.
        """
        # embree answers 0 for a hit and -1 for none, whatever was hit
        answer = self._scene.run(_float32(origins), _float32(directions), query="OCCLUDED")
        return torch.from_numpy(answer == 0)

    def faces_hit(
        self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "#r 3"]
    ) -> Int[Tensor, " r"]:
        """The first triangle along each ray, -1 for none; several times faster than where on it.

        Nothing is copied where both are contiguous float32.
        """
        found = self._scene.run(_float32(origins), _float32(directions), query="INTERSECT")
        return torch.from_numpy(found.astype(np.int64))

    def intersect(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "#r 3"]) -> Hits:
        """The first triangle along each ray.

        embree only names the triangle; where on it is worked out again in float64
        (Moeller and Trumbore 1997, eq. 6), so positions do not carry float32 noise.
        """
        face = self.faces_hit(origins, directions)
        hit = face >= 0
        origin = origins.detach().to("cpu", torch.float64)[hit]
        direction = directions.detach().to("cpu", torch.float64).expand(len(face), 3)[hit]
        a, b, c = self._corners[face[hit]].unbind(1)
        p = torch.linalg.cross(direction, c - a)
        q = torch.linalg.cross(origin - a, b - a)
        scale = ((b - a) * p).sum(1)
        u, v = ((origin - a) * p).sum(1) / scale, (direction * q).sum(1) / scale
        # a hit on an edge may lie a rounding error outside
        weights = torch.stack([1 - u - v, u, v], dim=1).clamp(min=0)
        barycentric = torch.zeros(len(face), 3, dtype=torch.float64)
        barycentric[hit] = weights / weights.sum(1, keepdim=True)
        distance = torch.full((len(face),), torch.inf, dtype=torch.float64)
        distance[hit] = ((c - a) * q).sum(1) / scale
        return Hits(face=face, barycentric=barycentric, distance=distance)


def checked_corners(
    vertices: Float[Tensor, "n 3"], faces: Int[Tensor, "f 3"]
) -> Float[Tensor, "f 3 3"]:
    """The corners of each triangle of a mesh to cast rays at, float64 on the CPU.

    Raises
    ------
    ValueError
        No triangle, or one of vertices that are not there.
    """
    if len(faces) == 0:
        raise ValueError("faces is empty: a mesh needs at least one triangle")
    if faces.min() < 0 or faces.max() >= len(vertices):  # embree would read past the array
        raise ValueError(f"faces must index the {len(vertices)} vertices")
    return vertices.detach().to("cpu", torch.float64)[faces.cpu()]


def lift(corners: Float[Tensor, "f 3 3"]) -> float:
    """How far a ray's start should be lifted off the surface of these triangles.

    1e-4 of the bounding box's diagonal, plus what float32 rounds away from the largest coordinate,
    so it means the same in millimetres and in metres.
    """
    return 1e-4 * _diagonal(corners) + 4 * float(np.finfo(np.float32).eps) * float(
        corners.abs().max()
    )


def _diagonal(corners: Float[Tensor, "f 3 3"]) -> float:
    return float((corners.amax((0, 1)) - corners.amin((0, 1))).norm())


def _float32(rows: Float[Tensor, "r 3"]) -> np.ndarray:
    return rows.detach().to("cpu", torch.float32).contiguous().numpy()
