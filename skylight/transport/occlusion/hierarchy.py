"""A bounding volume hierarchy over triangles, whose levels are arrays."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

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
