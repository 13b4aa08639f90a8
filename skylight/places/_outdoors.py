"""Outdoors by day and dusk, and the light that windows see: skies over their ground."""

import math
from dataclasses import dataclass
from datetime import datetime

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.places._materials import Draw, nits
from skylight.places._scene import Material, Outside, Real, Rectangle, Scene, black_body, box, panel
from skylight.skies._atmosphere import ClearSky
from skylight.skies._simulator import Day, simulate_sky
from skylight.skies.surroundings._scenes import surroundings
from skylight.sphere._frame import DirectionGrid, direction_from_angles

HEIGHT = 64  # rows of an outside's map
EYE_M = (1.3, 1.8)
GROUND_M = 60.0  # to the sides; what is farther is alike
MOST_SHADE = 0.9


@dataclass(frozen=True, kw_only=True)
class Outdoors:
    """A sky with what stands before it, over a ground that is alike to the horizon."""

    outside: Outside
    ground: Material
    ground_name: str
    sun_zenith_rad: Real


def draw_outdoors(
    day: Day, clear: ClearSky, moment: tuple[datetime, float, float], draw: Draw
) -> Outdoors:
    """A moment of a day, turned anyhow, before surroundings of its own."""
    sky = simulate_sky(day, clear, *moment, height=HEIGHT // 2)
    generator = torch.Generator().manual_seed(draw.count(0, 2**31 - 1))
    cover, before = (each[0] for each in surroundings(sky.sky.radiance[None], generator))
    above = sky.sunless.radiance * (1 - cover) + before * cover
    height, width = above.shape[:2]
    row = min(int(sky.sun_zenith_rad / (math.pi / 2) * height), height - 1)
    turn = draw.count(0, width - 1)  # columns
    azimuth = math.pi / (2 * height) * (0.5 + turn)
    sun = direction_from_angles(torch.tensor(azimuth), torch.tensor(sky.sun_zenith_rad))
    name, ground = draw.ground()
    hidden = cover[row, :, 0]
    shade = min(float(hidden.mean()), MOST_SHADE)
    above = torch.roll(above, turn, dims=1)
    beam = sky.sun_irradiance if math.cos(sky.sun_zenith_rad) > 0 else torch.zeros(3)
    lit = irradiance(above, torch.tensor([0.0, 1.0, 0.0]))
    lit = lit + (1 - shade) * beam * max(math.cos(sky.sun_zenith_rad), 0.0)
    below = torch.tensor(np.asarray(ground.albedo), dtype=torch.float32) / math.pi * lit
    return Outdoors(
        outside=Outside(
            map=torch.cat([above, below.expand(height, width, 3)]),
            sun=sun,
            sun_irradiance=beam,
            shade=shade,
            sunny=1 - float(hidden[width // 2]),
        ),
        ground=ground,
        ground_name=name,
        sun_zenith_rad=sky.sun_zenith_rad,
    )


def night(draw: Draw) -> Outside:
    """A dark sky over a town, brighter and warmer towards the horizon, or none to speak of."""
    glow = np.array(black_body(2300.0)) * draw.scale(0.003, 0.2)
    deep = np.array(black_body(7000.0)) * draw.scale(0.0005, 0.01)
    up = torch.linspace(1, 0, HEIGHT // 2 + 1)[:-1, None]
    sky = (
        torch.tensor(nits(deep, 1.0)).float()
        + torch.exp(-6 * up) * torch.tensor(nits(glow, 1.0)).float()
    )
    ground = 0.1 * sky.mean(0).expand(HEIGHT // 2, 3)
    light = torch.cat([sky, ground])[:, None].expand(HEIGHT, 2 * HEIGHT, 3)
    return Outside(map=light, sun=torch.tensor([0.0, 1.0, 0.0]), sun_irradiance=torch.zeros(3))


def irradiance(above: Float[Tensor, "h w 3"], normal: Float[Tensor, "3"]) -> Float[Tensor, "3"]:
    """By a sky or a full map on a surface of a normal."""
    grid = DirectionGrid.latlong(*above.shape[:2])
    weight = (grid.directions.float() @ normal).clamp(min=0) * grid.solid_angles.float()
    return weight @ above.reshape(-1, 3)


def open_air(outdoors: Outdoors, draw: Draw) -> Scene:
    """A viewer on the ground, at times beside walls, steps, tables or cars."""
    eye = draw.uniform(*EYE_M)
    things: list[Rectangle] = []
    for _ in range(draw.count(1, 4) if draw.chance(0.45) else 0):
        things += _thing(draw, eye)
    floor = panel((0, -eye, 0), (0, 1, 0), 2 * GROUND_M, 2 * GROUND_M, outdoors.ground)
    return Scene(rectangles=[floor, *things], outside=outdoors.outside)


def _thing(draw: Draw, eye: Real) -> list[Rectangle]:
    kind = draw.one_of([0.35, 0.25, 0.4])
    if kind == 0:  # the wall of a house, or a garden's
        size = draw.uniform(3, 14), draw.scale(1.2, 7), draw.uniform(0.3, 6)
        away, material = draw.scale(1.5, 15), draw.paint(0.45, 0.15, vivid=0.3)
    elif kind == 1:  # a car
        size = 4.3, draw.uniform(1.3, 1.8), 1.8
        away, material = draw.scale(2, 15), draw.furniture()
    else:  # a table, a bench, a hedge
        size = draw.uniform(0.5, 2.5), draw.scale(0.4, 1.6), draw.uniform(0.4, 1)
        away, material = draw.scale(1, 6), draw.furniture()
    reach = away + math.hypot(size[0], size[2]) / 2
    azimuth = draw.uniform(-math.pi, math.pi)
    x, z = reach * math.sin(azimuth), -reach * math.cos(azimuth)
    low = x - size[0] / 2, -eye, z - size[2] / 2
    high = x + size[0] / 2, size[1] - eye, z + size[2] / 2
    return box(low, high, material, turn_rad=azimuth + draw.normal(0, 0.3))
