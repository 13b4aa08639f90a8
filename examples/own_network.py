"""A sky network of your own: pixels of a sky to latents and back, by two layers each way.

cd examples
skylight skies simulate --days 160 --out runs/skies
skylight train --config own_network.yaml
skylight estimate portrait.jpg --model runs/own_network --network own_network:PixelNetwork
"""

import torch
from torch import Tensor, nn

from skylight.models import SkyNetwork

PIXELS, HIDDEN = 3 * 32 * 128, 256


class PixelNetwork(SkyNetwork):
    """Made by the number of latents; the last five are the sun's, which pass by the layers."""

    def __init__(self, latents: int) -> None:
        super().__init__(latents)
        self.encoder = nn.Sequential(
            nn.Flatten(), nn.Linear(PIXELS, HIDDEN), nn.SiLU(), nn.Linear(HIDDEN, latents - 5)
        )
        self.decoder = nn.Sequential(
            nn.Linear(latents, HIDDEN), nn.SiLU(), nn.Linear(HIDDEN, PIXELS)
        )

    def encode_coded(self, sun: Tensor, coded: Tensor) -> Tensor:
        """Latents (b, z) of suns (b, 5) and coded skies (b, 3, 32, 128)."""
        return torch.cat([self.encoder(coded), sun], 1)

    def decode_coded(self, z: Tensor) -> Tensor:
        """The coded skies (b, 3, 32, 128), without their suns."""
        return self.decoder(z).unflatten(1, (3, 32, 128))
