"""Augmentation of skies."""

import math
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from skylight.skies.loading import normalise
from skylight.sphere.frame import direction_from_angles
from skylight.sphere.grid import DirectionGrid
from skylight.training.config import AutoencoderConfig

HARMONICS = 12  # of a skyline's ups and downs
BUILDINGS = 5


def augment(
    batch: Float[Tensor, "b h w 3"], generator: torch.Generator, config: AutoencoderConfig
) -> Float[Tensor, "b h w 3"]:
    """Skies mirrored, tinted and with things before them, by chance; mean luminance 1.

    ``mirror``: every other sky. ``tint``: standard deviation of each channel's log gain, as
    cameras' white balances differ. ``obstacles``: the share of skies that get a skyline and
    perhaps a canopy (see :func:`obstacles`).
    """
    if config.mirror:
        # about the middle of column w/2, where the sun is: column c becomes w - c
        flipped = torch.roll(batch.flip(2), 1, dims=2)
        keep = torch.rand(len(batch), generator=generator) < 0.5
        batch = torch.where(keep[:, None, None, None], batch, flipped)
    if config.tint:
        gain = torch.exp(config.tint * torch.randn(len(batch), 1, 1, 3, generator=generator))
        batch = batch * gain
    if config.obstacles:
        cover, radiance = obstacles(batch, generator)
        some = torch.rand(len(batch), generator=generator) < config.obstacles
        cover = cover * some[:, None, None, None]
        batch = batch * (1 - cover) + radiance * cover
    return normalise(batch)


def obstacles(
    skies: Float[Tensor, "b h w 3"], generator: torch.Generator
) -> tuple[Float[Tensor, "b h w 1"], Float[Tensor, "b h w 3"]]:
    """(how much of each pixel something covers, the radiance of what covers it).

    A skyline of hills or trees (random harmonics of azimuth) and boxes, in a third of the skies
    also a canopy of leaves overhead. Surfaces are Lambertian, face the observer, and get the
    light of the whole sky, the sun's too where it stands behind the observer; a random factor
    stands for what they hide from each other.
    """
    count, height, width = skies.shape[:3]

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(count, *shape, generator=generator)

    azimuth = 2 * math.pi * (torch.arange(width) + 0.5) / width
    wave = torch.arange(1, HARMONICS + 1)
    phase = uniform(0.0, 2 * math.pi, HARMONICS, 1)
    strength = torch.randn(count, HARMONICS, 1, generator=generator) / wave[:, None] ** 0.7
    hills = (strength * torch.cos(wave[:, None] * azimuth + phase)).sum(1)
    skyline = uniform(0.0, 0.3, 1) * (1 + 0.5 * hills)
    centre, half = uniform(0.0, 2 * math.pi, BUILDINGS, 1), uniform(0.05, 0.6, BUILDINGS, 1)
    tall = 0.35 * -torch.log(uniform(1e-3, 1.0, BUILDINGS, 1))
    standing = uniform(0.0, 1.0, BUILDINGS, 1) < uniform(0.0, 0.8, 1, 1)
    away = torch.remainder(azimuth - centre + math.pi, 2 * math.pi) - math.pi
    boxes = (tall.clamp(max=1.2) * standing * (away.abs() < half)).amax(1)
    elevation = math.pi / 2 * (1 - (torch.arange(height) + 0.5) / height)
    edge = math.pi / 2 / height
    top = torch.maximum(skyline, boxes)
    cover = torch.sigmoid((top[:, None] - elevation[:, None]) / (0.5 * edge))

    leaves = functional.interpolate(
        functional.pad(
            torch.randn(count, 1, 4, 12, generator=generator), (2, 2, 0, 0), mode="circular"
        ),
        (height, width + width // 3),
        mode="bicubic",
    )[:, 0, :, width // 6 : width // 6 + width]
    leaves = leaves + 0.4 * torch.randn(count, height, width, generator=generator)
    canopy = torch.sigmoid(4 * (leaves - uniform(-0.5, 1.5, 1, 1)))
    has_canopy = uniform(0.0, 1.0, 1, 1) < 1 / 3
    cover = torch.maximum(cover, canopy * has_canopy)

    received = torch.einsum("kn,bnc->bkc", _facing(height), skies.flatten(1, 2))
    albedo = torch.exp(uniform(math.log(0.03), math.log(0.4), 1, 1, 1))
    colour = torch.exp(0.25 * torch.randn(count, 1, 1, 3, generator=generator))
    texture = torch.exp(0.3 * torch.randn(count, height, width, 1, generator=generator))
    hidden = uniform(0.3, 1.0, 1, width, 1)
    radiance = albedo * colour * texture * hidden * received[:, None] / math.pi
    return cover[..., None], radiance


@cache
def _facing(height: int) -> Float[Tensor, "w n"]:
    """<n, w>+ dw for walls that face the observer, one per column of a sky map."""
    grid = DirectionGrid.sky(height)
    width = 4 * height
    azimuth = 2 * math.pi * (torch.arange(width) + 0.5) / width - math.pi
    normals = -direction_from_angles(azimuth, torch.full_like(azimuth, math.pi / 2)).double()
    cosine = (normals @ grid.directions.T).clamp(min=0)
    return (cosine * grid.solid_angles).float()
