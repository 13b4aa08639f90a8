"""Subdivision of triangles, for light that varies within them."""

import math
from dataclasses import replace

import torch
from jaxtyping import Int
from torch import Tensor
from torch.nn.functional import normalize

from skylight.errors import InputError
from skylight.probes.partitions.relight.scene import Scene

MOST_TRIANGLES = 4_000_000


def refined(scene: Scene, longest_edge: float) -> Scene:
    """The same surface with no edge longer than ``longest_edge``, without gaps.

    All long edges are halved at once, so that triangles on both sides of an edge agree.
    """
    if not longest_edge > 0:
        raise InputError(f"the longest edge must be above 0, got {longest_edge:g}")
    while True:
        ends = torch.stack([scene.faces, scene.faces.roll(-1, 1)], 2).reshape(-1, 2).sort(1)[0]
        count = len(scene.vertices)
        edges, number = (ends[:, 0] * count + ends[:, 1]).unique(return_inverse=True)
        edges = torch.stack([edges // count, edges % count], 1)
        length = (scene.vertices[edges[:, 0]] - scene.vertices[edges[:, 1]]).norm(dim=1)
        long = length > longest_edge
        if not bool(long.any()):
            return scene
        middles = torch.full((len(edges),), -1)
        middles[long] = count + torch.arange(int(long.sum()))
        # no triangle of such edges is larger than the equilateral one
        least = scene.area / (math.sqrt(0.1875) * longest_edge**2)
        if max(least, len(scene.faces)) > MOST_TRIANGLES:
            raise InputError(
                f"edges of {longest_edge:g} at most take more than {MOST_TRIANGLES} triangles: "
                "allow longer ones"
            )
        halves = edges[long]
        scene = replace(
            scene,
            vertices=_with_middles(scene.vertices, halves),
            faces=_split(scene.faces, middles[number].reshape(-1, 3)),
            normals=normalize(_with_middles(scene.normals, halves), dim=1),
            albedo=_with_middles(scene.albedo, halves),
            uv=None if scene.uv is None else _with_middles(scene.uv, halves),
        )


def _with_middles(values: Tensor, ends: Int[Tensor, "e 2"]) -> Tensor:
    return torch.cat([values, values[ends].mean(1)])


def _split(faces: Int[Tensor, "f 3"], middles: Int[Tensor, "f 3"]) -> Int[Tensor, "g 3"]:
    """Triangles with the middles (or -1) of the edges 01, 12 and 20, cut there."""
    cut = middles >= 0
    count = cut.sum(1)
    # one cut edge comes first, an uncut one beside two cut ones last
    turn = torch.where(count == 1, cut.int().argmax(1), ((~cut).int().argmax(1) + 1) % 3)
    turn = torch.where((count == 1) | (count == 2), turn, 0)
    index = (torch.arange(3) + turn[:, None]) % 3
    a, b, c = faces.gather(1, index).T
    ab, bc, ca = middles.gather(1, index).T
    pieces = {
        0: [(a, b, c)],
        1: [(a, ab, c), (ab, b, c)],
        2: [(ab, b, bc), (a, ab, c), (ab, bc, c)],
        3: [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)],
    }
    return torch.cat(
        [torch.stack(p, 1)[count == cuts] for cuts, each in pieces.items() for p in each]
    )
