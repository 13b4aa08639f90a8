"""Augmentation of skies."""

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.skies.loading import normalise
from skylight.skies.surroundings.scenes import surroundings
from skylight.sphere.grid import DirectionGrid
from skylight.training.config import AutoencoderConfig


def augment(
    batch: Float[Tensor, "b h w 3"], generator: torch.Generator, config: AutoencoderConfig
) -> Float[Tensor, "b h w 3"]:
    """Skies mirrored, tinted and with things before them, by chance; mean luminance 1.

    ``mirror``: every other sky. ``tint``: standard deviation of each channel's log gain, as
    cameras' white balances differ. ``surroundings``: the share of skies that get them (see
    :func:`~skylight.skies.surroundings.scenes.surroundings`). ``white_balance``: a channel of
    mean m over the hemisphere, sun and surroundings included, is multiplied by m^-u, where u is
    uniform from 0 to ``white_balance``; 1 is a grey mean, to which cameras tend.
    """
    if config.mirror:
        # about the middle of column w/2, where the sun is: column c becomes w - c
        flipped = torch.roll(batch.flip(2), 1, dims=2)
        keep = torch.rand(len(batch), generator=generator) < 0.5
        batch = torch.where(keep[:, None, None, None], batch, flipped)
    if config.tint:
        gain = torch.exp(config.tint * torch.randn(len(batch), 1, 1, 3, generator=generator))
        batch = batch * gain
    if config.surroundings:
        some = torch.rand(len(batch), generator=generator) < config.surroundings
        cover, radiance = surroundings(batch[some], generator)
        batch = batch.clone()
        batch[some] = batch[some] * (1 - cover) + radiance * cover
    if config.white_balance:
        solid = DirectionGrid.sky(batch.shape[1]).solid_angles.to(batch)
        mean = torch.einsum("n,bnc->bc", solid, batch.flatten(1, 2)).clamp(min=1e-6)
        towards = config.white_balance * torch.rand(len(batch), 1, generator=generator)
        batch = batch * mean.pow(-towards)[:, None, None]
    return normalise(batch)
