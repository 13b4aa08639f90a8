"""A network of a user's, as small as one can be: sixteenths of a sky, by a layer each way."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from skylight.models import SkyNetwork


class TinyNetwork(SkyNetwork):
    def __init__(self, latents: int) -> None:
        super().__init__(latents)
        self.norm = nn.BatchNorm1d(3 * 4 * 16)
        self.encoder = nn.Linear(3 * 4 * 16, latents - 5)
        self.drop = nn.Dropout(0.2)
        self.decoder = nn.Linear(latents, 3 * 4 * 16)

    def encode_coded(self, sun: Tensor, coded: Tensor) -> Tensor:
        seen = self.norm(functional.avg_pool2d(coded, 8).flatten(1))
        return torch.cat([self.encoder(self.drop(seen)), sun], 1)

    def decode_coded(self, z: Tensor) -> Tensor:
        return functional.interpolate(self.decoder(z).unflatten(1, (3, 4, 16)), scale_factor=8)


class OtherNetwork(TinyNetwork):
    """Nothing but another name."""
