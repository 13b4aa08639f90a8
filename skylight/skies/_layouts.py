"""Layouts of captured skies, resampled to upper-hemisphere maps.

==========  ==================================================================================
skylatlong  upper half of a lat-long map, width = 4 heights (the Laval HDR Sky Database)
latlong     whole lat-long map, width = 2 heights; the lower half is dropped
angular     square, zenith in the middle, equidistant: zenith angle = field / 2 x distance from
            the middle / half the width. Seen by a camera that looks up: azimuth 0 (the centre
            column of a lat-long map) is at the *bottom*, azimuth +90 degrees on the *right*,
            180 at the top
fisheye     the same turned by 180 degrees, as photographs taken upwards lie: azimuth 0 at the
            *top*, azimuth +90 degrees on the *left*
==========  ==================================================================================

What lies outside the inscribed circle, or below the horizon, is dropped.
"""

import math
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float
from scipy.sparse import csr_array
from torch import Tensor

from skylight._modes import constant
from skylight.errors import InputError
from skylight.io._light import read_linear
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid

Layout = Literal["skylatlong", "latlong", "angular", "fisheye"]
SQUARE: tuple[Layout, Layout] = ("angular", "fisheye")
FIELD_DEG = 180.0
# Squares above this are averaged down first: 512 pixels across 180 degrees are finer than any
# sky that is learnt from, and the weights below cost time and memory by the square's area.
_LARGEST = 512


def read_sky(path: Path, layout: Layout, *, field_deg: float = FIELD_DEG) -> EnvironmentMap:
    """The upper hemisphere that a file shows; ``field_deg`` counts for square layouts alone."""
    return sky_of(read_pixels(path, layout, field_deg=field_deg)[1], layout, field_deg=field_deg)


def read_pixels(
    path: Path, layout: Layout | None = None, *, field_deg: float = FIELD_DEG
) -> tuple[Layout, Float[Tensor, "h w 3"]]:
    """(layout, a file's pixels as they lie, those of the sky alone: others are cut off or 0).

    ``layout`` None takes what the shape says; a square is then angular.

    Raises :class:`InputError` for a shape that is not the layout's, and for radiance of the sky
    that is NaN, infinite or negative.
    """
    pixels = torch.from_numpy(read_linear(path))
    height, width = pixels.shape[:2]
    shape = f"{path}: {width}x{height} (width x height)"
    shapes: dict[int, Layout] = {4 * height: "skylatlong", 2 * height: "latlong", height: "angular"}
    guess = shapes.get(width)
    if guess is None:
        raise InputError(
            f"{shape} is no shape of a sky: expected a width of 4 heights (skylatlong), 2 heights "
            "(latlong), or a square (angular, fisheye); crop or resize it"
        )
    layout = layout or guess
    if guess != layout and not (guess in SQUARE and layout in SQUARE):
        raise InputError(f"{shape} is not the shape of a map in the layout {layout}, but {guess}")
    if layout == "latlong":
        pixels = pixels[: height // 2]
    elif layout in SQUARE:
        pixels = torch.where(pixel_solid_angles(height, field_deg)[..., None] > 0, pixels, 0.0)
    bad = ~(pixels.isfinite() & (pixels >= 0)).all(-1)
    if bad.any():
        row, column = bad.nonzero()[0].tolist()
        raise InputError(
            f"{path}: radiance must be finite and >= 0, got {int(bad.sum())} NaN, infinite or "
            f"negative pixel(s), the first at row {row}, column {column}; repair or replace them"
        )
    return layout, pixels


def sky_of(
    pixels: Float[Tensor, "h w 3"], layout: Layout, *, field_deg: float = FIELD_DEG
) -> EnvironmentMap:
    """Pixels of :func:`read_pixels` as a sky map, the integral over solid angle kept.

    A square of n x n pixels becomes a map of n / 8 rows, 32 at least and 64 at most.
    """
    if layout not in SQUARE:
        return EnvironmentMap(radiance=pixels)
    size = pixels.shape[0]
    solid = pixel_solid_angles(size, field_deg)
    energy = pixels.double() * solid[..., None]
    if size > _LARGEST:
        bins = _bins(size, _LARGEST)
        energy = torch.einsum("ia,abc->ibc", bins, energy)
        energy = torch.einsum("jb,ibc->ijc", bins, energy)
    height = max(32, energy.shape[0] // 8)
    shares = _spread(size, field_deg, height)
    light = torch.from_numpy(shares @ energy.reshape(-1, 3).numpy())
    light = light.reshape(height, 4 * height, 3)
    if layout == "fisheye":
        light = torch.roll(light, 2 * height, dims=1)
    solid = DirectionGrid.sky(height).solid_angles.reshape(height, 4 * height, 1)
    return EnvironmentMap(radiance=(light / solid).float())


@constant(4)
def pixel_solid_angles(size: int, field_deg: float) -> Float[Tensor, "n n"]:
    """Solid angle of each pixel of a square map that is sky: sum 2 pi, 0 outside, float64.

    A pixel is sky where its middle is; its solid angle is, with ``|x|, |y| <= 1`` across the
    square, d omega = (sin t / t) (field / 2)^2 dx dy, t = field / 2 sqrt(x^2 + y^2).
    """
    if not 180 <= field_deg <= 360:
        raise InputError(f"a field of {field_deg:g} degrees: a sky needs 180 to 360")
    place = (2 * torch.arange(size, dtype=torch.float64) + 1) / size - 1
    half = math.radians(field_deg) / 2
    zenith = half * torch.hypot(place[:, None], place[None])
    solid = torch.sinc(zenith / math.pi) * (2 * half / size) ** 2
    solid = torch.where(zenith < math.pi / 2, solid, 0.0)
    return solid * (2 * math.pi / solid.sum())


@constant(2)
def _spread(size: int, field_deg: float, height: int) -> csr_array:
    """Sparse (sky pixels, square's pixels): the share of a pixel's energy that goes where.

    The overlaps are counted on a grid finer than both. Scaling their rows and columns in turn
    (Sinkhorn & Knopp 1967) makes both solid angles right: each column sums to 1, so no energy
    is lost, and a uniform square becomes a uniform sky.
    """
    source = pixel_solid_angles(size, field_deg)
    if size > _LARGEST:
        bins = _bins(size, _LARGEST)
        source = bins @ source @ bins.T
    size = source.shape[0]
    fine = -(-max(3 * size, 768) // height) * height  # a multiple of height
    zenith = (torch.arange(fine, dtype=torch.float64) + 0.5) * math.pi / 2 / fine
    azimuth = ((torch.arange(4 * fine, dtype=torch.float64) + 0.5) / (4 * fine) - 0.5) * 2 * math.pi
    distance = (zenith / math.radians(field_deg / 2))[:, None]
    column = ((1 + distance * torch.sin(azimuth)) * size / 2).long().clamp(0, size - 1)
    row = ((1 + distance * torch.cos(azimuth)) * size / 2).long().clamp(0, size - 1)
    each = fine // height
    target = torch.arange(fine)[:, None] // each * 4 * height + torch.arange(4 * fine) // each
    key, index = (target * size**2 + row * size + column).flatten().unique(return_inverse=True)
    sky, square = key // size**2, key % size**2
    solid = torch.sin(zenith)[:, None].expand(-1, 4 * fine).flatten()
    overlap = torch.zeros(len(key), dtype=torch.float64).index_add_(0, index, solid)
    wanted_sky, wanted_square = DirectionGrid.sky(height).solid_angles, source.flatten()
    for _ in range(20):
        overlap *= (wanted_sky / _sums(overlap, sky, len(wanted_sky)))[sky]
        overlap *= (wanted_square / _sums(overlap, square, size**2).clamp(min=1e-300))[square]
    shares = overlap / wanted_square[square].clamp(min=1e-300)
    shape = (len(wanted_sky), size**2)
    return csr_array((shares.numpy(), (sky.numpy(), square.numpy())), shape=shape)


def _sums(values: Float[Tensor, " n"], index: Tensor, count: int) -> Float[Tensor, " m"]:
    return torch.zeros(count, dtype=values.dtype).index_add_(0, index, values)


def _bins(size: int, fewer: int) -> Float[Tensor, "m n"]:
    """(fewer, size): how much of each of ``size`` equal cells falls into each of ``fewer``."""
    low = torch.arange(size, dtype=torch.float64)
    edges = torch.arange(fewer + 1, dtype=torch.float64) * size / fewer
    upper = torch.minimum(low + 1, edges[1:, None])
    return (upper - torch.maximum(low, edges[:-1, None])).clamp(min=0)
