"""Maps as people have them, made into the skies that networks code: see :func:`centred`."""

import math
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from skylight._modes import constant, transformed
from skylight.errors import InputError, check_shape
from skylight.models._network import CENTRE_AZIMUTH_RAD, HEIGHT, WIDTH
from skylight.models._sun_head import NEAR_RAD, RING_RAD
from skylight.sphere._envmap import averaged, luminance
from skylight.sphere._frame import DirectionGrid, cosines, zenith_span

_REFINEMENTS = 3  # of the sun's place, each about the one before


class CentredSkies(NamedTuple):
    """``skies`` (b,32,128,3) of mean luminance 1 with their suns in the centre column, where they
    stood, ``azimuth_rad`` (b,), and the maps' mean luminance, ``scale`` (b,), float64.

    ``beside_rad`` (b,) is how far right of the column's middle they stand."""

    skies: Float[Tensor, "b h w 3"]
    azimuth_rad: Float[Tensor, " b"]
    beside_rad: Float[Tensor, " b"]
    scale: Float[Tensor, " b"]


def centred(maps: Float[Tensor, "b h w 3"]) -> CentredSkies:
    """Upper halves of full maps, or skies, averaged to 32 rows and turned by whole columns.

    They are turned before they are averaged, so that nothing is blurred and suns are within half a
    column of the map beside the middle.
    """
    upper = _upper(maps).double()
    if upper.shape[1] < HEIGHT:
        upper = averaged(upper, HEIGHT)
    grid = DirectionGrid.sky(upper.shape[1])
    light = luminance(upper.flatten(1, 2))
    scale = light @ grid.solid_angles.to(light) / (2 * math.pi)
    light = light / scale[:, None]
    sun = _sun(light, grid)
    azimuth = torch.atan2(sun[:, 0], -sun[:, 2])
    width = upper.shape[2]
    column = 2 * math.pi / width
    turn = ((azimuth.detach() - CENTRE_AZIMUTH_RAD) / column).round()
    columns = (torch.arange(width, device=turn.device) + turn.long()[:, None]) % width
    turned = upper.gather(2, columns[:, None, :, None].expand_as(upper))
    skies = averaged(turned, HEIGHT) / scale[:, None, None, None]
    return CentredSkies(skies, azimuth, azimuth - CENTRE_AZIMUTH_RAD - turn * column, scale)


def _upper(maps: Float[Tensor, "b h w 3"]) -> Float[Tensor, "b k w 3"]:
    """The rows above the horizon; :class:`InputError` for what is no light of a sky."""
    check_shape("AutoencoderLight's maps", maps.shape, 3)
    height, width = maps.shape[1:3]
    if zenith_span(height, width) == math.pi:
        if height % 2:
            raise InputError(
                f"the horizon of maps of {height} rows lies within a row: make their number even "
                "(skylight.sphere.averaged)"
            )
        maps = maps[:, : height // 2]
    if torch.compiler.is_compiling() or transformed() or maps.is_meta:
        return maps  # values cannot be looked at
    if not bool((maps.isfinite() & (maps >= 0)).all()):
        raise InputError("a map has radiance that is negative, NaN or infinite: repair it first")
    dark = ~maps.flatten(1).any(1)
    if bool(dark.any()):
        raise InputError(
            f"map {int(dark.nonzero()[0])} is black above the horizon: give one of light"
        )
    return maps


def _sun(light: Float[Tensor, "b n"], grid: DirectionGrid) -> Float[Tensor, "b 3"]:
    """Of the most light within six degrees: unit vectors, differentiable.

    Less half of what the mean from 6 to 10 degrees would give there, so that a sun is found beside
    bright clouds, and the brightest place where there is none; at each of 32 x 128 pixels. From the
    best of them on, the centroid of what exceeds that mean, on the map's own pixels.
    """
    solid, directions = grid.solid_angles.to(light), grid.directions.to(light)
    height, width = grid.layout or (0, 0)
    coarse = averaged(light.detach().unflatten(1, (height, width))[..., None], HEIGHT)[..., 0]
    waves = torch.einsum("rsm,bsm->brm", _filter().to(light.device), torch.fft.rfft(coarse))
    best = torch.fft.irfft(waves, n=WIDTH).flatten(1).argmax(1)
    sun = DirectionGrid.sky(HEIGHT).directions.to(light)[best]
    for _ in range(_REFINEMENTS):
        cosine = cosines(sun.detach(), directions)
        near = (cosine > math.cos(NEAR_RAD)) * solid
        ring = (cosine > math.cos(RING_RAD)) * solid - near
        level = (ring * light).sum(1) / ring.sum(1)
        excess = near * (light - level[:, None]).clamp(min=0)
        # where nothing exceeds it the place stays
        centroid = excess @ directions + 1e-9 * sun.detach()
        sun = centroid / centroid.norm(dim=1, keepdim=True)
    return sun


@constant()
def _filter() -> Complex[Tensor, "r s m"]:
    """Fourier series in azimuth of the weights of pixels of row s for a pixel of row r."""
    grid = DirectionGrid.sky(HEIGHT)
    cosine = cosines(grid.directions[::WIDTH], grid.directions)  # of the first column
    near = (cosine > math.cos(NEAR_RAD)) * grid.solid_angles
    ring = (cosine > math.cos(RING_RAD)) * grid.solid_angles - near
    weight = near - 0.5 * ring * (near.sum(1) / ring.sum(1))[:, None]
    return torch.fft.rfft(weight.unflatten(1, (HEIGHT, WIDTH))).conj()
