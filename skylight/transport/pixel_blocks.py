"""Means over square blocks of a picture's pixels."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.transport.matrix import SeenDirections

_ROWS = 32  # at a time: copies that stay in a core's cache


@dataclass(frozen=True, kw_only=True)
class PixelBlocks:
    """Pixels in blocks: pixel ``members[i]`` is in block ``index[i]`` with a ``share`` of it.

    Shares are the pixels' weights over those of their block, whose sum is ``weights`` (b,);
    ``places`` (b,2) are rows and columns of blocks, ``clipped`` (b,) whether their pixels are.
    Pixels without weight are in none.
    """

    members: Int[Tensor, " j"]
    index: Int[Tensor, " j"]
    share: Float[Tensor, "j 1"]
    weights: Float[Tensor, " b"]
    places: Int[Tensor, "b 2"]
    clipped: Bool[Tensor, " b"] | None

    @staticmethod
    def of(
        places: Int[Tensor, "m 2"],
        weights: Float[Tensor, " m"],
        clipped: Bool[Tensor, " m"] | None,
        size: int,
    ) -> "PixelBlocks":
        """Blocks of ``size`` times ``size`` pixels; those that are ``clipped`` have their own."""
        cell = places // size
        key = cell[:, 0] * (int(cell[:, 1].max()) + 1) + cell[:, 1]
        if clipped is not None:  # a mean with a lower bound in it would be no more than one
            key = 2 * key + clipped
        members = (weights > 0).nonzero()[:, 0]
        blocks, index = torch.unique(key[members], return_inverse=True)
        weight = weights[members]
        total = weight.new_zeros(len(blocks)).index_add_(0, index, weight)
        where = cell.new_zeros(len(blocks), 2)
        where[index] = cell[members]
        return PixelBlocks(
            members=members,
            index=index,
            share=(weight / total[index])[:, None],
            weights=total,
            places=where,
            clipped=None if clipped is None else blocks % 2 == 1,
        )

    def means(self, rows: Float[Tensor, "m c"] | SeenDirections) -> Float[Tensor, "b c"]:
        """Weighted means of what each pixel has, or of its row of the transport matrix."""
        some = rows[self.members[:1]]
        sums = some.new_zeros(len(self.weights), some.shape[1])
        every = (each.split(_ROWS) for each in (self.index, self.members, self.share))
        for index, members, share in zip(*every, strict=True):
            sums.index_add_(0, index, share.to(some) * rows[members])
        return sums

    def heaviest(self) -> Int[Tensor, " b"]:
        """The member of most weight of each block."""
        order = self.share[:, 0].argsort(stable=True)  # of several writes the last stays
        found = self.members.new_zeros(len(self.weights))
        found[self.index[order]] = self.members[order]
        return found
