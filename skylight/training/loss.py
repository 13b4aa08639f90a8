"""The loss of the sky autoencoder."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.models.autoencoder import SkyAutoencoder
from skylight.sphere.grid import DirectionGrid
from skylight.training.config import AutoencoderConfig
from skylight.training.corruption import Corruption


def reconstruction_loss(
    network: SkyAutoencoder,
    clean: Float[Tensor, "b h w 3"],
    config: AutoencoderConfig,
    corruption: Corruption | None = None,
) -> Float[Tensor, " b"]:
    """``mean of (1 + g max(L, L')) |d| + s (mean of d^2 - (mean of d)^2)`` per sky, d = y' - y.

    Means are over solid angle and channels, of the sky without its sun where the network has a
    sun head. The first part is the thesis' solid-angle-weighted L1, on coded radiance y, plus
    ``energy_weight`` g times the same weighted by the energy of the pixel as well (of truth or
    reconstruction, whichever is larger, taken as a constant): about L1 of radiance where both
    agree, but its slope does not vanish where a sun of a thousand times the sky's radiance is
    missing altogether. The second, ``scale_invariant`` s, forgives a wrong exposure (Gardner et
    al. 2023, RENI++). The network encodes y, or what the ``corruption`` makes of it.
    """
    sun, rest = network.split(clean)
    truth = network.code(rest)
    seen = truth
    if corruption is not None:
        seen = corruption.kept * (truth + corruption.noise)
        sun = sun + corruption.sun[:, : sun.shape[1]]
    coded = network.decode_coded(network.encode_coded(sun, seen)).float()
    error = coded - truth
    larger = torch.maximum(rest, network.uncode(coded).detach()).permute(0, 3, 1, 2)
    height, width = error.shape[-2:]
    row = DirectionGrid.latlong(height, width).solid_angles.reshape(height, width)[:, :1]
    share = row.to(error) / (3 * 2 * math.pi)
    loss = (share * (1 + config.energy_weight * larger) * error.abs()).sum((1, 2, 3))
    if config.scale_invariant:
        mean = (share * error).sum((1, 2, 3))
        spread = (share * error.square()).sum((1, 2, 3)) - mean.square()
        loss = loss + config.scale_invariant * spread
    return loss
