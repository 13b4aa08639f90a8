"""Occlusion by PyTorch, on the CPU or a GPU."""

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.transport.occlusion.hierarchy import Hierarchy
from skylight.transport.raycast import checked_corners, lift

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
    :class:`~skylight.transport.raycast.OcclusionCaster`.

    For GPUs: on a CPU embree (:class:`~skylight.transport.raycast.Raycaster`) is 40 to 120 times as
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
