"""Lat-long maps turned about any axis: bilinear samples of a map that is evenly fine.

Columns crowd at the poles, where samples that are a pixel of the equator apart would miss most of
what is there, or count it several times. So what a row resolves beyond the height of its pixels is
averaged first, with its energy kept; then samples are close enough everywhere.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import grid_sample, pad

from skylight._modes import full_precision

_ROWS = 8  # turned at a time: of a map of 256 rows their samples stay in a core's cache


def turned(
    radiance: Float[Tensor, "h w c"], rotation: Float[Tensor, "3 3"], samples: int
) -> Float[Tensor, "h w c"]:
    """``L'(w) = L(R^T w)``: means of ``samples**2`` look-ups in each pixel, by solid angle."""
    height, width, _ = radiance.shape
    planes = _surrounded(_evenly_fine(radiance.permute(2, 0, 1)))
    turn = rotation.to(radiance.device, torch.float64)
    edges = torch.linspace(0, math.pi, 2 * height * samples + 1, dtype=torch.float64).to(turn)
    zenith, cosines = edges[1::2, None], torch.cos(edges[::2])
    azimuth = (torch.arange(width * samples).to(turn) + 0.5) * (2 * math.pi / samples / width)
    # w is sin(zenith) (-sin, 0, cos)(azimuth) + cos(zenith) (0, 1, 0), from the map's left edge
    across = torch.cos(azimuth) * turn[2, :, None] - torch.sin(azimuth) * turn[0, :, None]
    across, up = across.to(radiance), (torch.cos(zenith) * turn[1]).to(radiance)
    sine = torch.sin(zenith).to(radiance)
    share = (cosines[:-1] - cosines[1:]).reshape(height, samples)
    share = (share / share.sum(1, keepdim=True) / samples)[:, None].to(radiance)
    rows = []
    parts = up.split(_ROWS * samples), sine.split(_ROWS * samples), share.split(_ROWS)
    for here_up, here_sine, weight in zip(*parts, strict=True):
        x, y, z = (here_up[:, i, None] + here_sine * across[i] for i in range(3))
        column = torch.atan2(x, -z) * (width / math.pi / (width + 2))
        row = torch.atan2(torch.sqrt(x * x + z * z), y)
        row = row * (2 * height / math.pi / (height + 2)) + (2 / (height + 2) - 1)
        # pairs are made six times as fast as complex numbers as by stacking
        place = torch.view_as_real(torch.complex(column, row))[None]
        found = grid_sample(planes[None], place, padding_mode="border", align_corners=False)[0]
        with full_precision(found):
            down = weight @ found.unflatten(1, (-1, samples))
        rows.append(down[:, :, 0].unflatten(2, (-1, samples)).sum(3))
    return torch.cat(rows, 1).permute(1, 2, 0)


def _evenly_fine(planes: Float[Tensor, "c h w"]) -> Float[Tensor, "c h w"]:
    """Each row averaged along itself over ``1 / sin(zenith)`` columns: as wide as pixels are high.

    A whole number of pixels and equal parts of those at both ends.
    """
    _, height, width = planes.shape
    half = width // 2  # a row's average takes a third of it at most
    sines = torch.sin((torch.arange(height, dtype=torch.float64) + 0.5) * (math.pi / height))
    beside = (1 / sines - 1) / 2  # columns on either side
    inside = beside < 1  # part of one
    caps = int((~inside).sum()) // 2
    part = beside[:, None].to(planes)
    evenly = planes + part * (planes.roll(1, 2) + planes.roll(-1, 2))
    evenly = evenly / (1 + 2 * part)
    rows = [*range(caps), *range(height - caps, height)]
    narrow = planes[:, rows]
    # sums from the left in float64: a sun is 1e5 times brighter than what stands beside it
    around = torch.cat([narrow[..., half:], narrow, narrow[..., :half]], 2).double()
    sums = pad(around.cumsum(2), (1, 0))
    averaged = []
    for i, reach in enumerate(beside[rows].tolist()):
        left, right = half - int(reach), half + int(reach) + 1
        whole = sums[:, i, right : right + width] - sums[:, i, left : left + width]
        ends = around[:, i, right : right + width] + around[:, i, left - 1 : left - 1 + width]
        averaged.append((whole + reach % 1 * ends) / (1 + 2 * reach))
    if not averaged:
        return evenly
    of_caps = torch.stack(averaged, 1).to(planes)
    return torch.cat([of_caps[:, :caps], evenly[:, caps : height - caps], of_caps[:, caps:]], 1)


def _surrounded(planes: Float[Tensor, "c h w"]) -> Float[Tensor, "c h2 w2"]:
    """A pixel more at each side: what is across the seam, and beyond a pole half a turn away."""
    half = planes.shape[2] // 2
    top, bottom = planes[:, :1].roll(half, 2), planes[:, -1:].roll(half, 2)
    tall = torch.cat([top, planes, bottom], 1)
    return torch.cat([tall[..., -1:], tall, tall[..., :1]], 2)
