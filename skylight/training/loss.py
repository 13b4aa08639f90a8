"""The loss of the sky autoencoder."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.models.networks.base import SkyNetwork
from skylight.models.networks.sun_head import COORDINATES
from skylight.sphere.grid import DirectionGrid
from skylight.training.config import AutoencoderConfig
from skylight.training.skies.corruption import Corruption


def reconstruction_loss(
    network: SkyNetwork,
    sun: Float[Tensor, "b s"],
    truth: Float[Tensor, "b 3 h w"],
    config: AutoencoderConfig,
    corruption: Corruption | None = None,
) -> Float[Tensor, " b"]:
    """The loss of each sky, of coordinates ``sun`` (none without a sun head) and coded rest y::

        mean of (1 + g max(L, L')) |d| + q d^2, plus s (mean of d^2 - (mean of d)^2)
        plus p mean of z^2,    d = y' - y

    The first means are over solid angle and channels. They hold the thesis' solid-angle-weighted
    L1, on coded radiance, plus ``energy_weight`` g times the same weighted by the energy of the
    pixel as well (of truth or reconstruction, whichever is larger, taken as a constant): about L1
    of radiance where both agree, but its slope does not vanish where a sun of a thousand times
    the sky's radiance is missing altogether. ``squared_weight`` q counts large errors, as clouds'
    edges are, more than L1 does, which is content with a median. ``scale_invariant`` s forgives a
    wrong exposure (Gardner et al. 2023, RENI++). ``latent_penalty`` p keeps the latents z (but
    the sun's) near 0, so that a ``corruption`` of given size has a meaning.

    The network encodes y, or what the ``corruption`` makes of it, and decodes its own latents or
    those.
    """
    seen = truth
    if corruption is not None:
        seen = corruption.kept * (truth + corruption.noise)
        sun = sun + corruption.sun[:, : sun.shape[1]]
    z = network.encode_coded(sun, seen)
    own = z[:, : network.latents - COORDINATES * network.sun]
    penalty = own.float().square().mean(1)
    if corruption is not None:
        z = torch.cat([own + corruption.latents, z[:, own.shape[1] :]], 1)
    coded = network.decode_coded(z).float()
    error = coded - truth
    energy = torch.maximum(_radiance(network, truth), _radiance(network, coded.detach()))
    height, width = error.shape[-2:]
    row = DirectionGrid.latlong(height, width).solid_angles.reshape(height, width)[:, :1]
    share = row.to(error) / (3 * 2 * math.pi)
    each = (1 + config.energy_weight * energy) * error.abs()
    if config.squared_weight:
        each = each + config.squared_weight * error.square()
    loss = (share * each).sum((1, 2, 3))
    if config.scale_invariant:
        mean = (share * error).sum((1, 2, 3))
        spread = (share * error.square()).sum((1, 2, 3)) - mean.square()
        loss = loss + config.scale_invariant * spread
    return loss + config.latent_penalty * penalty


def _radiance(network: SkyNetwork, coded: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 h w"]:
    return network.uncode(coded).permute(0, 3, 1, 2)
