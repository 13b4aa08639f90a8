"""Ray casting at a triangle mesh: by embree on the CPU, or by PyTorch on any device.

:class:`Raycaster` finds closest hits and occlusion by embree. :class:`TorchRaycaster` answers
occlusion alone, by a bounding volume hierarchy over the triangles whose levels are arrays.
"""

import math
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
    (:class:`~skylight.transport._rays.TorchRaycaster`).

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

    def between(
        self, origins: Float[Tensor, "r 3"], targets: Float[Tensor, "r 3"]
    ) -> Bool[Tensor, " r"]:
        """True where anything lies between two points, less a thousandth of the way to each."""
        way = _float32(targets - origins)
        reach = np.full(len(way), 1 - 2e-3, np.float32)
        start = _float32(origins + 1e-3 * (targets - origins))
        answer = self._scene.run(start, way, dists=reach, query="OCCLUDED")
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
    """The corners of each triangle of a mesh to cast rays at, float64 on the CPU."""
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


LEAF = 4  # triangles, at most
_HALVINGS = 3  # of a node: eight children


@dataclass(frozen=True, kw_only=True)
class Hierarchy:
    """``levels`` (n, c, 2, 3) are the lowest and highest corners of each node's c children's boxes.

    Child k of node i is node ``c i + k`` of the next level, and of the last level leaf ``c i + k``:
    ``leaves`` (l, t, 3, 3) are the corners of its triangles. All leaves have as many: some
    triangles, evenly chosen, are there twice. Few triangles are one leaf, without levels.
    """

    levels: tuple[Float[np.ndarray, "_ _ 2 3"], ...]
    leaves: Float[np.ndarray, "l t 3 3"]

    @staticmethod
    def over(corners: Float[np.ndarray, "f 3 3"]) -> "Hierarchy":
        """Of one triangle or more: halved by number, along the longest side of the centres' box."""
        halvings = max(0, math.ceil(math.log2(len(corners) / LEAF)))
        order = _halved((corners[:, 0] + corners[:, 1] + corners[:, 2]) / 3, halvings)
        leaves = corners[order]
        boxes = np.stack([leaves.min((1, 2)), leaves.max((1, 2))], 1)
        levels = []
        left = halvings
        while left:
            below = _HALVINGS if left >= _HALVINGS else left  # the root may have fewer children
            children = boxes.reshape(-1, 2**below, 2, 3)
            levels.append(children)
            boxes = np.stack([children[:, :, 0].min(1), children[:, :, 1].max(1)], 1)
            left -= below
        return Hierarchy(levels=tuple(reversed(levels)), leaves=leaves)


def _halved(centres: Float[np.ndarray, "f 3"], halvings: int) -> Int[np.ndarray, "l t"]:
    """The triangles of each of ``2**halvings`` leaves, some repeated so that all have as many."""
    count = 2**halvings
    size = math.ceil(len(centres) / count)
    order = (np.arange(count * size) * len(centres) // (count * size))[None]
    for _ in range(halvings):
        there = centres[order]
        longest = (there.max(1) - there.min(1)).argmax(1)
        along = np.take_along_axis(there, longest[:, None, None], 2)[..., 0]
        order = np.take_along_axis(order, along.argsort(1, kind="stable"), 1)
        order = order.reshape(2 * len(order), -1)
    return order


# Rays and nodes that are looked at together: in the caches of a CPU, or 0.5 GB of a GPU
_PAIRS_CPU, _PAIRS_GPU = 2**12, 2**20
# By such a factor float32 may place the exit of a box too near: 1 + 2 g, g = 3 e / (1 - 3 e) (Ize
# 2013, "Robust BVH ray traversal", J. of Computer Graphics Techniques 2(2))
_EXIT = 1 + 2 * 3 * 2.0**-24
# Times |d|_1 max|p - q| max|p + q|: more than what rounding does to a volume, which is at most 14
# times 2^-24 and was below 4 times it in 1.8 million; the more, the more rays beside a mesh hit it
_BESIDE = 2.0**-21
_LEAST = 1e-30  # of a direction's coordinates: their inverses are finite


class TorchRaycaster:
    """Whether rays hit a triangle mesh, in PyTorch on a device: an
    :class:`~skylight.transport._rays.OcclusionCaster`.

    For GPUs: on a CPU embree (:class:`~skylight.transport._rays.Raycaster`) is 40 to 120 times as
    fast. Both answer alike but for rays that pass a vertex or an edge to float32's rounding, of
    which embree lets some through; none of 400,384 from a head's vertices upwards differs.

    Pairs of a ray and a node go down a :class:`Hierarchy` level by level: from each, those of the
    ray and the children whose boxes it enters. A triangle a, b, c is hit where the ray o + t d
    passes all edges on one side, by the signs of three volumes (Kensler & Shirley 2006,
    "Optimizing ray-triangle intersection via automated search", eq. 5 to 7), ::

        d . (a' x b'),  d . (b' x c'),  d . (c' x a'),      a' = a - o, ...,

    each computed so that the two triangles at an edge see the same number with opposite signs: no
    ray passes between them. Nor does one through a vertex, where the signs at several edges are but
    rounding: a volume of less than it is rounded by has both signs (:data:`_BESIDE`).

    Of at most ``pairs`` at a time; scratch memory is 500 bytes each, by default 2 MB on the CPU and
    0.5 GB on a GPU.
    """

    def __init__(
        self,
        vertices: Float[Tensor, "n 3"],
        faces: Int[Tensor, "f 3"],
        device: torch.device,
        *,
        pairs: int | None = None,
    ) -> None:
        corners = checked_corners(vertices, faces)
        self.device = device
        self.epsilon = lift(corners)
        self.pairs = pairs or (_PAIRS_CPU if device.type == "cpu" else _PAIRS_GPU)
        self.most_rays = 2 * _PAIRS_GPU
        tree = Hierarchy.over(corners.float().numpy())
        self._levels = [_tensor(level).to(device) for level in tree.levels]
        self._leaves = _tensor(tree.leaves).to(device)

    @torch.no_grad()
    def occluded(
        self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "#r 3"]
    ) -> Bool[Tensor, " r"]:
        """True where a ray hits anything at all, on the device of ``origins``."""
        start = origins.to(self.device, torch.float32)
        along = directions.to(self.device, torch.float32).expand(len(start), 3)
        hit = torch.zeros(len(start), dtype=torch.bool, device=self.device)
        every = torch.arange(len(start), device=self.device)
        waiting = [(0, every, torch.zeros_like(every))]
        while waiting:
            level, rays, nodes = waiting.pop()
            if len(rays) > self.pairs:
                waiting.append((level, rays[self.pairs :], nodes[self.pairs :]))
                rays, nodes = rays[: self.pairs], nodes[: self.pairs]
            left = ~hit[rays]
            rays, nodes = rays[left], nodes[left]
            if level == len(self._levels):
                hit[rays[_meets(start[rays], along[rays], self._leaves[nodes])]] = True
                continue
            boxes = self._levels[level][nodes]
            pair, child = _enters(start[rays], along[rays], boxes).nonzero().unbind(1)
            if len(pair):
                waiting.append((level + 1, rays[pair], boxes.shape[1] * nodes[pair] + child))
        return hit.to(origins.device)


def _enters(
    start: Float[Tensor, "k 3"], along: Float[Tensor, "k 3"], boxes: Float[Tensor, "k c 2 3"]
) -> Bool[Tensor, "k c"]:
    """Which boxes each ray passes through, or a little beside: never one too few."""
    inverse = torch.where(along.abs() < _LEAST, _LEAST, along).reciprocal()
    planes = (boxes - start[:, None, None]) * inverse[:, None, None]
    first, last = planes.unbind(2)
    near = torch.minimum(first, last).amax(2)
    far = torch.maximum(first, last).amin(2) * _EXIT
    return (near <= far) & (far >= 0)


def _meets(
    start: Float[Tensor, "k 3"], along: Float[Tensor, "k 3"], corners: Float[Tensor, "k t 3 3"]
) -> Bool[Tensor, " k"]:
    """Which rays meet one of their triangles."""
    a, b, c = (corners - start[:, None, None]).unbind(2)
    towards = along[:, None].expand_as(a)
    left = right = torch.ones(a.shape[:2], dtype=torch.bool, device=a.device)
    for edge in ((a, b), (b, c), (c, a)):
        volume, rounding = _volume(towards, *edge)
        left, right = left & (volume >= -rounding), right & (volume <= rounding)
    normal = torch.linalg.cross(b - a, c - a)
    height, slope = (a * normal).sum(2), (towards * normal).sum(2)
    # by both signs: their product may be too small for single precision
    ahead = ((height > 0) & (slope > 0)) | ((height < 0) & (slope < 0))
    return ((left | right) & ahead).any(1)


def _volume(
    d: Float[Tensor, "k t 3"], p: Float[Tensor, "k t 3"], q: Float[Tensor, "k t 3"]
) -> tuple[Float[Tensor, "k t"], Float[Tensor, "k t"]]:
    """(2 d . (p x q), what it may be rounded by).

    The sign turns exactly where p and q are exchanged. By differences and sums, since p and q are
    nearly parallel where a triangle is far away.
    """
    apart, both = p - q, p + q
    size = d.abs().sum(2) * apart.abs().amax(2) * both.abs().amax(2)
    return (d * torch.linalg.cross(apart, both)).sum(2), _BESIDE * size


def _tensor(array: Float[np.ndarray, "*s"]) -> Float[Tensor, "*s"]:
    return torch.from_numpy(np.ascontiguousarray(array))
