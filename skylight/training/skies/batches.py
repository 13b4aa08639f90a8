"""Batches of skies: their order and corruption, as functions of the seed."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.training.config import AutoencoderConfig
from skylight.training.skies.corruption import Corruption, draw_corruption
from skylight.training.skies.prepared import CodedSkies


def draw_batch(
    copies: Sequence[CodedSkies],
    config: AutoencoderConfig,
    epoch: int,
    within: int,
    share: slice,
) -> tuple[Float[Tensor, "b s"], Float[Tensor, "b 3 h w"], Corruption]:
    """Batch ``within`` of an epoch, of the copy whose turn it is, and its corruption.

    Both depend on seed, epoch and place alone. They are drawn for the whole batch, of which
    ``share`` is returned: several processes together see what one would have seen.
    """
    skies = copies[epoch % len(copies)]
    order = torch.Generator().manual_seed(config.seed * 1_000_003 + epoch)
    permutation = torch.randperm(len(skies), generator=order)
    chosen = permutation[within * config.batch : (within + 1) * config.batch]
    sun, coded = skies.batch(chosen[share].numpy())
    local = torch.Generator().manual_seed((config.seed * 1_000_003 + epoch) * 1_000_003 + within)
    height, width = coded.shape[2:]
    corruption = draw_corruption(len(chosen), (height, width), local, config)
    return sun, coded, Corruption(*(part[share] for part in corruption))
