"""Batches of skies: order, augmentation and corruption, as functions of the seed."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.training.augment import augment
from skylight.training.config import AutoencoderConfig
from skylight.training.corruption import Corruption, draw_corruption


def draw_batch(
    skies: Float[np.ndarray, "n h w 3"],
    config: AutoencoderConfig,
    epoch: int,
    within: int,
    share: slice,
) -> tuple[Float[Tensor, "b h w 3"], Corruption]:
    """Batch ``within`` of an epoch and its corruption.

    Both depend on seed, epoch and place alone. They are drawn for the whole batch, of which
    ``share`` is returned: several processes together see what one would have seen.
    """
    order = torch.Generator().manual_seed(config.seed * 1_000_003 + epoch)
    permutation = torch.randperm(len(skies), generator=order)
    chosen = permutation[within * config.batch : (within + 1) * config.batch]
    batch = torch.from_numpy(skies[chosen.numpy()])  # fancy indexing copies from the disk's map
    local = torch.Generator().manual_seed((config.seed * 1_000_003 + epoch) * 1_000_003 + within)
    batch = augment(batch, local, config)
    height, width = batch.shape[1:3]
    corruption = draw_corruption(len(batch), (height, width), local, config)
    return batch[share], Corruption(*(part[share] for part in corruption))
