"""A design's cells drawn on the sphere (thesis, Fig. 4.3 and 4.4)."""

import colorsys
import math

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.probes.partitions._cells import Cells

_SAMPLES = 3  # along each side of a pixel
_BORDER_RAD = 0.012
_BORDER_GREY = 0.05
_SEED_RAD = 0.025
_CHUNK = 2**15  # directions that are looked at together
_GOLDEN = (math.sqrt(5) - 1) / 2


def draw_cells(
    cells: Cells, *, size: int = 480, elevation_rad: float = 0.5, azimuth_rad: float = 0.5
) -> UInt8[np.ndarray, "h w 3"]:
    """The sphere from a camera far off in a direction, and beside it from the opposite one.

    The camera's direction has that elevation above the XZ plane and that azimuth, from +Z towards
    +X; borders are black, seeds white. 8-bit sRGB, ``size`` rows by twice as many columns.
    """
    views = []
    for back in (False, True):
        right, up, towards = _view(elevation_rad, azimuth_rad, back)
        fine = size * _SAMPLES
        place = ((torch.arange(fine, dtype=torch.float64) + 0.5) / fine * 2 - 1) * 1.04
        y, x = torch.meshgrid(-place, place, indexing="ij")
        inside = x**2 + y**2 < 1
        depth = (1 - x**2 - y**2).clamp(min=0).sqrt()
        hit = x[..., None] * right + y[..., None] * up + depth[..., None] * towards
        colour = torch.ones(fine, fine, 3, dtype=torch.float64)
        shade = 0.45 + 0.55 * depth[inside]
        colour[inside] = _surface(cells, hit[inside]) * shade[:, None]
        blocks = colour.reshape(size, _SAMPLES, size, _SAMPLES, 3).mean((1, 3))
        views.append((blocks * 255).round().to(torch.uint8).numpy())
    return np.concatenate(views, axis=1)


def _surface(cells: Cells, directions: Float[Tensor, "m 3"]) -> Float[Tensor, "m 3"]:
    seeds, label = cells.design.seeds, cells.design.labels
    apart = torch.cdist(seeds, seeds).clamp(min=1e-9)
    colours = cell_colours(cells)
    parts = []
    for part in directions.split(_CHUNK):
        near = part @ seeds.T
        best = near.argmax(1)
        # sine of the angle to the great circle halfway between the closest seed and each other
        beside = (near.gather(1, best[:, None]) - near) / apart[best]
        beside = beside.masked_fill(label[best][:, None] == label[None], math.inf)
        border = (beside.amin(1) < math.sin(_BORDER_RAD))[:, None]
        marked = (near.amax(1) > math.cos(_SEED_RAD))[:, None]
        colour = torch.where(border, _BORDER_GREY, colours[label[best]])
        parts.append(torch.where(marked, 1.0, colour))
    return torch.cat(parts)


def cell_colours(cells: Cells) -> Float[Tensor, "n 3"]:
    """Display colours in [0, 1], those of neighbours far apart in hue."""
    hues: dict[int, float] = {}
    for cell, near in enumerate(cells.neighbours):
        taken = [hues[j] for j in torch.nonzero(near)[:, 0].tolist() if j in hues]
        choices = [(cell * _GOLDEN + step / 12) % 1 for step in range(12)]
        hues[cell] = max(choices, key=lambda hue: min((_apart(hue, h) for h in taken), default=1.0))
    rows = [colorsys.hsv_to_rgb(hue, 0.5, 1.0) for hue in hues.values()]
    return torch.tensor(rows, dtype=torch.float64)


def _apart(first: float, second: float) -> float:
    difference = abs(first - second) % 1
    return min(difference, 1 - difference)


def _view(elevation_rad: float, azimuth_rad: float, back: bool) -> tuple[Tensor, Tensor, Tensor]:
    flat, sine = math.cos(elevation_rad), math.sin(elevation_rad)
    towards = [flat * math.sin(azimuth_rad), sine, flat * math.cos(azimuth_rad)]
    right = [math.cos(azimuth_rad), 0.0, -math.sin(azimuth_rad)]
    sign = -1.0 if back else 1.0
    t = sign * torch.tensor(towards, dtype=torch.float64)
    r = sign * torch.tensor(right, dtype=torch.float64)
    return r, torch.linalg.cross(t, r), t
