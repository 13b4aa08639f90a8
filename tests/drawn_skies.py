"""A folder of .exr skies, each of its own day: a sun in haze or an overcast sky."""

import math
from pathlib import Path

import numpy as np
import torch

from skylight.io._hdr import write_exr
from skylight.sphere._frame import DirectionGrid, angle_between, direction_from_angles


def draw_skies(out: Path, count: int) -> None:
    """``count`` skies of 32 x 128 pixels, the same ones every time."""
    draw = np.random.default_rng(0)
    grid = DirectionGrid.sky(32)
    for number in range(count):
        azimuth, zenith = draw.uniform(-math.pi, math.pi), draw.uniform(0.2, 1.4)
        place = direction_from_angles(torch.tensor(azimuth), torch.tensor(zenith)).double()
        angle = angle_between(grid.directions, place.expand_as(grid.directions))
        sun = float(draw.uniform(0, 3000) * (number % 3 > 0))
        haze = draw.uniform(0.2, 2.0)
        light = 1 + haze * torch.exp(-angle) + sun * torch.exp(-((angle / 0.03) ** 2))
        colour = torch.tensor([1.0, 1.0 + 0.1 * number / count, 1.2])
        pixels = (light[:, None] * colour).reshape(32, 128, 3).numpy().astype(np.float32)
        write_exr(out / f"2024-{1 + number // 20:02d}-{1 + number % 20:02d}.exr", pixels,
                  half=False, header={})  # fmt: skip
