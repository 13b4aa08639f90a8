"""What the network is shown instead of a clean sky: the corruption that it learns to undo."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.models.networks.sun_head import COORDINATES
from skylight.training.config import AutoencoderConfig

BLOCK = 8  # rows and columns of what is hidden together: 22.5 degrees


class Corruption(NamedTuple):
    """The encoder sees ``kept * (y + noise)`` for coded radiance y, and ``sun`` is added to the
    sun's coordinates and ``latents`` to the others; the loss compares with y itself."""

    noise: Float[Tensor, "b 3 h w"]
    kept: Float[Tensor, "b 1 h w"]
    sun: Float[Tensor, "b s"]
    latents: Float[Tensor, "b z"]

    @staticmethod
    def stack(parts: "Sequence[Corruption]") -> "Corruption":
        """Those of several skies as one batch."""
        return Corruption(*(torch.cat(each) for each in zip(*parts, strict=True)))

    def to(self, device: torch.device) -> "Corruption":
        return Corruption(*(part.to(device) for part in self))


def draw_corruption(
    count: int,
    layout: tuple[int, int],
    generator: torch.Generator,
    config: AutoencoderConfig,
) -> Corruption:
    """Gaussian noise of ``noise_sigma``, blocks hidden with probability ``masked``, noise of
    ``sun_noise`` on the sun's coordinates and of ``latent_noise`` on the other latents (Vincent et
    al. 2010: additive and masking noise)."""
    height, width = layout

    def normal(*shape: int) -> Tensor:
        return torch.randn(count, *shape, generator=generator)

    noise = normal(3, height, width) * config.noise_sigma
    rows, columns = height // BLOCK, width // BLOCK
    hidden = torch.rand(count, 1, rows, columns, generator=generator) < config.masked
    kept = (~hidden).float().repeat_interleave(BLOCK, 2).repeat_interleave(BLOCK, 3)
    return Corruption(
        noise=noise,
        kept=kept,
        sun=normal(COORDINATES) * config.sun_noise,
        latents=normal(config.latents - COORDINATES * config.sun) * config.latent_noise,
    )
