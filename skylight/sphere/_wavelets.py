"""Haar wavelets on the cube map: non-linear approximation, a baseline.

Ng, Ramamoorthi & Hanrahan 2003, "All-frequency shadows using non-linear wavelet lighting
approximation": light on a cube map, a 2D Haar transform of each face, and only the largest
coefficients kept.

A cube map is (6, n, n, c), n a power of two, faces +X, -X, +Y, -Y, +Z, -Z of the world frame,
each as a camera at the centre sees it: the side faces upright (row 0 towards +Y), +Y and -Y as
the frame's camera, which looks along -Z, sees them after it has tilted up or down. (OpenGL's
faces are seen from outside, mirrored.) Texels are even on the plane of their face.
"""

import math
from collections.abc import Sequence
from typing import Literal, get_args

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight._modes import constant
from skylight.sphere._frame import DirectionGrid, direction_from_angles, row_edges_cos

Selection = Literal["magnitude", "area", "weighted"]

# forward, right = forward x up, down, of each face in order
_FORWARD = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
_RIGHT = ((0, 0, 1), (0, 0, -1), (1, 0, 0), (1, 0, 0), (-1, 0, 0), (1, 0, 0))
_DOWN = ((0, -1, 0), (0, -1, 0), (0, 0, -1), (0, 0, 1), (0, -1, 0), (0, -1, 0))

# Measured for 128x256 maps at size 64: with 12 and 20 a single pixel's energy is wrong by 0.6 %
# at most (0.05 % rms), with 8 and none by 9 % (1.2 %).
_SAMPLES = 12  # along the edge of a texel in the middle of a face
_BALANCE_PASSES = 20
_GOLDEN_RATIO = (1 + math.sqrt(5)) / 2


def texel_solid_angles(size: int) -> Float[Tensor, "6 n n"]:
    """Exact solid angles in sr, float64: differences of atan2(x y, sqrt(x^2 + y^2 + 1)).

    That is the solid angle of the rectangle from (0, 0) to (x, y) on the plane at distance 1.
    """
    _check_size(size)
    edge = torch.linspace(-1, 1, size + 1, dtype=torch.float64)
    x, y = edge[None], edge[:, None]
    corner = torch.atan2(x * y, torch.sqrt(x * x + y * y + 1))
    return corner.diff(dim=0).diff(dim=1).expand(6, size, size)


def texel_from_direction(direction: Float[Tensor, "*s 3"], size: int) -> Int[Tensor, "*s"]:
    """Index, in the flattened (6, n, n), of the texel in each direction (of any length)."""
    _check_size(size)
    forward, right, down = (axes.to(direction) for axes in _face_axes())
    distance, face = (direction @ forward.T).max(dim=-1)
    column, row = (
        (((direction * axes[face]).sum(-1) / distance + 1) * (size / 2)).long().clamp(0, size - 1)
        for axes in (right, down)
    )
    return (face * size + row) * size + column


def cube_from_latlong(radiance: Float[Tensor, "h w c"], size: int) -> Float[Tensor, "6 n n c"]:
    """A full lat-long map (w = 2h) averaged over each texel's solid angle.

    Pixels and texels count as constant inside, so this is the nearest cube map in L2. A constant
    stays what it is. Energy is kept to 1e-7 for smooth maps and to 0.6 % for a single bright
    pixel (128x256 at size 64; bounded by a test), as overlaps are sampled.
    """
    height, width, channels = radiance.shape
    if width != 2 * height:
        raise ValueError(
            f"radiance must be a full lat-long map, twice as wide as high, got {width}x{height} "
            "(width x height): complete a sky with EnvironmentMap.with_ground"
        )
    texel, pixel, overlap = _overlaps(height, size)
    mean = _average(radiance.reshape(-1, channels), pixel, texel, overlap, 6 * size**2)
    return mean.reshape(6, size, size, channels)


def latlong_from_cube(cube: Float[Tensor, "f n m c"], height: int) -> Float[Tensor, "h w c"]:
    """A cube map, constant inside each texel, averaged over each pixel of a lat-long map.

    The same overlaps as in :func:`cube_from_latlong`: its adjoint, to within its error of energy.
    """
    size = _check_cube(cube)
    texel, pixel, overlap = _overlaps(height, size)
    mean = _average(cube.reshape(-1, cube.shape[-1]), texel, pixel, overlap, 2 * height**2)
    return mean.reshape(height, 2 * height, -1)


def approximate(
    cube: Float[Tensor, "f n m c"], counts: Sequence[int], selection: Selection = "magnitude"
) -> list[Float[Tensor, "f n m c"]]:
    """For each of ``counts``, the cube map made of that many wavelets, the most important ones.

    One choice for all channels, by the norm of a wavelet's coefficients across them. Selections:

    ``magnitude``
        that norm: the least error in the sum over texels (Ng et al.'s unweighted selection).
    ``area``
        times the square root of the solid angle of the wavelet's support, as what an orthonormal
        wavelet sends out, the integral of ``|c psi|``, grows with it (after their area weighting).
    ``weighted``
        radiance is multiplied by the square root of the texels' solid angles before the transform
        and divided by it after the inverse: the least error in the sum over solid angle.

    The result may be negative somewhere, as in the paper. Raises ``ValueError`` unless each count
    lies between 0 and 6 n^2.
    """
    size = _check_cube(cube)
    if selection not in get_args(Selection):
        raise ValueError(
            f"unknown selection {selection!r}: choose one of {', '.join(get_args(Selection))}"
        )
    for count in counts:
        if not 0 <= count <= 6 * size**2:
            raise ValueError(f"counts must lie between 0 and 6 n^2 = {6 * size**2}, got {count}")
    solid_angles = texel_solid_angles(size)[..., None].to(cube)
    scale = solid_angles.sqrt() if selection == "weighted" else torch.ones_like(solid_angles)
    coefficients = haar(cube * scale)
    importance = coefficients.norm(dim=-1, keepdim=True)
    if selection == "area":
        importance = importance * _support(solid_angles).sqrt()
    # stable: among equals the first in the layout, so that every machine chooses alike
    order = importance.flatten().argsort(descending=True, stable=True)
    rank = torch.empty_like(order)
    rank[order] = torch.arange(len(order), device=order.device)
    rank = rank.reshape(importance.shape)
    return [inverse_haar(coefficients * (rank < count)) / scale for count in counts]


def haar(cube: Float[Tensor, "f n n c"]) -> Float[Tensor, "f n n c"]:
    """Orthonormal 2D Haar transform of each face, non-standard decomposition.

    Rows and columns are halved in turn (Stollnitz, DeRose & Salesin 1995, part 1), coarse to
    fine from the corner: coefficient (0, 0) is ``n`` times the mean of the face, and the sum
    of squares is that of the texels.
    """
    if cube.shape[1] == 1:
        return cube
    a, b = cube[:, 0::2, 0::2], cube[:, 0::2, 1::2]
    c, d = cube[:, 1::2, 0::2], cube[:, 1::2, 1::2]
    return _quarters(
        haar((a + b + c + d) / 2), (a - b + c - d) / 2, (a + b - c - d) / 2, (a - b - c + d) / 2
    )


def inverse_haar(coefficients: Float[Tensor, "f n n c"]) -> Float[Tensor, "f n n c"]:
    """The cube map that :func:`haar` transforms into ``coefficients``: its transpose."""
    half = coefficients.shape[1] // 2
    if half == 0:
        return coefficients
    mean = inverse_haar(coefficients[:, :half, :half])
    x, y = coefficients[:, :half, half:], coefficients[:, half:, :half]
    xy = coefficients[:, half:, half:]
    upper = torch.stack([mean + x + y + xy, mean - x + y - xy], dim=3)
    lower = torch.stack([mean + x - y - xy, mean - x - y + xy], dim=3)
    # (f, row, row parity, column, column parity, c)
    return torch.stack([upper, lower], dim=2).reshape(coefficients.shape) / 2


def _support(solid_angles: Float[Tensor, "f n n c"]) -> Float[Tensor, "f n n c"]:
    """Solid angle of the support of each wavelet, laid out as the coefficients are."""
    if solid_angles.shape[1] == 1:
        return solid_angles
    half = solid_angles.shape[1] // 2
    block = solid_angles.reshape(6, half, 2, half, 2, -1).sum((2, 4))
    return _quarters(_support(block), block, block, block)


def _quarters(
    corner: Float[Tensor, "f n n c"],
    right: Float[Tensor, "f n n c"],
    below: Float[Tensor, "f n n c"],
    diagonal: Float[Tensor, "f n n c"],
) -> Float[Tensor, "f m m c"]:
    top, bottom = torch.cat([corner, right], dim=2), torch.cat([below, diagonal], dim=2)
    return torch.cat([top, bottom], dim=1)


@constant()
def _overlaps(
    height: int, size: int
) -> tuple[Int[Tensor, " k"], Int[Tensor, " k"], Float[Tensor, " k"]]:
    """(texel, pixel, solid angle in sr) of every texel that overlaps a lat-long pixel, float64.

    Sampled by a fine lat-long grid inside the pixels, then balanced: scaled in turn so that the
    overlaps of each pixel, and lastly of each texel, sum to its exact solid angle (Sinkhorn &
    Knopp 1967). What is left of the pixels' error is the error of energy.
    """
    _check_size(size)
    width = 2 * height
    samples = max(4, math.ceil(_SAMPLES * 2 * size / height))
    rows, columns = height * samples, width * samples
    edges = row_edges_cos(rows, columns)
    zenith = (torch.arange(rows, dtype=torch.float64) + 0.5) * (math.pi / rows)
    # each row shifted within its samples: where texels' edges run along the columns, an aligned
    # grid would put all rows on the same side of them
    shift = (torch.arange(1, rows + 1, dtype=torch.float64) * _GOLDEN_RATIO) % 1
    column = torch.arange(columns)
    parts = []
    for i in range(height):  # row by row: the fine grid of a large map does not fit in memory
        fine = slice(i * samples, (i + 1) * samples)
        azimuth = ((column + shift[fine, None]) / columns - 0.5) * (2 * math.pi)
        direction = direction_from_angles(azimuth, zenith[fine, None].expand_as(azimuth))
        pair = texel_from_direction(direction, size) * width + column // samples
        pair, place = pair.unique(return_inverse=True)
        solid_angle = -edges[i * samples : (i + 1) * samples + 1].diff() * (2 * math.pi / columns)
        overlap = torch.zeros(len(pair), dtype=torch.float64).index_add(
            0, place.flatten(), solid_angle.repeat_interleave(columns)
        )
        parts.append((pair // width, pair % width + i * width, overlap))
    texel, pixel, overlap = (torch.cat(part) for part in zip(*parts, strict=True))
    texel_sum = texel_solid_angles(size).flatten()
    pixel_sum = DirectionGrid.latlong(height).solid_angles
    for _ in range(_BALANCE_PASSES):
        for index, exact in ((pixel, pixel_sum), (texel, texel_sum)):
            found = torch.zeros_like(exact).index_add(0, index, overlap)
            overlap = overlap * (exact / found)[index]
    return texel, pixel, overlap


def _average(
    values: Float[Tensor, "m c"],
    source: Int[Tensor, " k"],
    target: Int[Tensor, " k"],
    weight: Float[Tensor, " k"],
    count: int,
) -> Float[Tensor, "count c"]:
    """Weighted mean of ``values[source]`` for each of ``count`` targets."""
    source, target = source.to(values.device), target.to(values.device)
    # float64 sums: a sun is 1e5 times brighter than what it is averaged with
    weight = weight.to(values.device)[:, None]
    total = weight.new_zeros(count, 1).index_add(0, target, weight)
    sums = weight.new_zeros(count, values.shape[1])
    sums = sums.index_add(0, target, weight * values.double()[source])
    return (sums / total).to(values.dtype)


@constant()
def _face_axes() -> tuple[Float[Tensor, "6 3"], Float[Tensor, "6 3"], Float[Tensor, "6 3"]]:
    forward, right, down = torch.tensor([_FORWARD, _RIGHT, _DOWN], dtype=torch.float64)
    return forward, right, down


def _check_size(size: int) -> None:
    if size < 1 or size & (size - 1):
        raise ValueError(f"size must be a power of two (texels along a face's edge), got {size}")


def _check_cube(cube: Float[Tensor, "f n m c"]) -> int:
    """The size of a cube map's faces."""
    if cube.shape[0] != 6 or cube.shape[1] != cube.shape[2]:
        raise ValueError(f"a cube map must be (6, n, n, c), got {tuple(cube.shape)}")
    _check_size(cube.shape[1])
    return cube.shape[1]
