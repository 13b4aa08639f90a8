"""Outdoors by day and dusk, and the light that windows see: skies over their ground."""

import math
from dataclasses import dataclass
from datetime import datetime

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.places._materials import BARK, CROWNS, Draw, nits
from skylight.places._scene import Material, Outside, Real, Rectangle, Scene, black_body, box, panel
from skylight.skies._atmosphere import ClearSky
from skylight.skies._simulator import Day, simulate_sky
from skylight.skies.surroundings._layer import Draws, rough_noise
from skylight.skies.surroundings._scenes import surroundings
from skylight.sphere._frame import DirectionGrid, direction_from_angles

HEIGHT = 64  # rows of an outside's map
EYE_M = (1.3, 1.8)
GROUND_M = 60.0  # to the sides; what is farther is alike
MOST_SHADE = 0.9
CANOPY = 0.12  # share of places under trees
TILE = 128  # of the crowns' noise
EDGE = 1 / 12  # of crowns, in shares of the sky


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
    if draw.chance(CANOPY):
        crowns, leaves = canopy(sky.sky.radiance, draw, generator, leaf_area=draw.scale(0.4, 5))
        before = (cover * before * (1 - crowns) + crowns * leaves) / (
            crowns + cover * (1 - crowns)
        ).clamp(min=1e-6)
        cover = crowns + cover * (1 - crowns)
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


def canopy(
    sky: Float[Tensor, "h w 3"], draw: Draw, generator: torch.Generator, *, leaf_area: Real
) -> tuple[Float[Tensor, "h w 1"], Float[Tensor, "h w 3"]]:
    """(how much of each pixel of a sky crowns overhead hide, their radiance from below).

    ``exp(-L / (2 sin e))`` of the sky at an elevation e shows through leaves of all slopes, of L
    times the ground's area (Monsi & Saeki 1953). Leaves let through about what they reflect.
    """
    height, width, _ = sky.shape
    directions = DirectionGrid.sky(height).directions.float()
    sine = directions[:, 1].clamp(min=0.02)
    gap = torch.exp(-leaf_area / (2 * sine))
    # where the eye's rays meet the crowns, in samples of the noise
    near = draw.uniform(2, 8) / sine.clamp(min=0.1)
    place = (near[:, None] * directions[:, [0, 2]]).round().long() % TILE
    noise = rough_noise(Draws(count=2, generator=generator), TILE, TILE, 0.8)
    holes, light = noise[:, place[:, 0], place[:, 1]]
    ranked = 0.5 * (1 + torch.erf(holes / math.sqrt(2)))  # even from 0 to 1
    cover = torch.where(gap < 0.02, 1.0, torch.sigmoid((1 - gap - ranked) / EDGE))
    down = irradiance(sky, torch.tensor([0.0, 1.0, 0.0]))
    leaf = torch.tensor(draw.between(CROWNS), dtype=torch.float32)
    shine = draw.scale(0.3, 1.2) * torch.exp(0.6 * light)
    radiance = shine[:, None] * leaf / math.pi * down
    return cover.reshape(height, width, 1), radiance.reshape(height, width, 3)


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
    """A viewer on the ground: in the open, or at walls, under a roof, by the sea, under trees."""
    eye = draw.uniform(*EYE_M)
    floor = panel((0, -eye, 0), (0, 1, 0), 2 * GROUND_M, 2 * GROUND_M, outdoors.ground)
    things: list[Rectangle] = []
    for _ in range(draw.count(1, 4) if draw.chance(0.45) else 0):
        things += _thing(draw, eye)
    if draw.chance(0.14):  # a portrait before a wall
        away, wide = draw.scale(0.35, 3), draw.scale(2, 15)
        low, high = (-wide / 2 + draw.uniform(-1, 1), -eye, -away - 0.3), draw.scale(0.6, 8)
        things += box(
            low, (low[0] + wide, high, -away), draw.facade(), turn_rad=draw.normal(0, 0.3)
        )
    elif draw.chance(0.1):
        things += _lane(draw, eye)
    if draw.chance(0.08):
        things += _roof(draw, eye)
    if outdoors.ground_name in ("sand", "gravel", "concrete", "planks") and draw.chance(0.3):
        away = draw.scale(1.5, 25)  # of the sea
        _, water = draw.ground("water")
        middle = (GROUND_M + away) / 2
        sea = panel((0, 0.02, middle), (0, 1, 0), 2 * GROUND_M, GROUND_M - away, water)
        turned = Scene(rectangles=[sea], outside=outdoors.outside)
        things += turned.seen_from((0, eye, 0), draw.uniform(-math.pi, math.pi)).rectangles
    if outdoors.ground_name in ("leaves", "soil", "grass") and draw.chance(0.25):
        for _ in range(draw.count(3, 20)):
            things += _trunk(draw, eye)
    return Scene(rectangles=[floor, *things], outside=outdoors.outside)


def _lane(draw: Draw, eye: Real) -> list[Rectangle]:
    """Houses on two or three sides."""
    walls: list[Rectangle] = []
    turn = draw.uniform(-math.pi, math.pi)
    for side in (1, -1, 2)[: draw.count(2, 3)]:
        azimuth = turn + side * math.pi / 2
        away, high, long = draw.scale(1.2, 9), draw.scale(2.5, 18), draw.scale(8, 40)
        reach = away + 4
        x, z = reach * math.sin(azimuth), -reach * math.cos(azimuth)
        low, top = (x - long / 2, -eye, z - 4), (x + long / 2, high - eye, z + 4)
        walls += box(low, top, draw.facade(), turn_rad=azimuth)
    return walls


def _roof(draw: Draw, eye: Real) -> list[Rectangle]:
    """A deck overhead on posts, at times with a wall: a bridge, a porch, a market's roof."""
    high = draw.scale(2.4, 9)
    wide, long = draw.scale(1.5, 12), draw.scale(2, 25)
    x, z = draw.uniform(-0.6, 0.6) * wide, draw.uniform(-0.6, 0.6) * long
    low = np.array([x - wide / 2, high - eye, z - long / 2])
    parts = box(low, low + np.array([wide, draw.scale(0.1, 1.2), long]), draw.facade())
    post = draw.facade()
    for a in (0.03, 0.97):
        for b in (0.05, 0.5, 0.95):
            at = low + np.array([a * wide, 0, b * long])
            parts += box((at[0] - 0.1, -eye, at[2] - 0.1), (at[0] + 0.1, at[1], at[2] + 0.1), post)
    if draw.chance(0.5):
        wall = low[0] if x < 0 else low[0] + wide
        end = low[2] + long
        parts += box((wall - 0.1, -eye, low[2]), (wall + 0.1, high - eye, end), draw.facade())
    return parts


def _trunk(draw: Draw, eye: Real) -> list[Rectangle]:
    """The four sides of a trunk."""
    away, azimuth, half = (
        draw.scale(1.5, 20),
        draw.uniform(-math.pi, math.pi),
        draw.scale(0.06, 0.4),
    )
    x, z = away * math.sin(azimuth), -away * math.cos(azimuth)
    bark = Material(albedo=draw.between(BARK), texture=0.2)
    high = draw.scale(4, 14)
    sides = box((x - half, -eye, z - half), (x + half, high, z + half), bark, turn_rad=azimuth)
    return [each for k, each in enumerate(sides) if k not in (2, 3)]


def _thing(draw: Draw, eye: Real) -> list[Rectangle]:
    kind = draw.one_of([0.35, 0.25, 0.4])
    if kind == 0:  # the wall of a house, or a garden's
        size = draw.uniform(3, 14), draw.scale(1.2, 7), draw.uniform(0.3, 6)
        away, material = draw.scale(0.8, 15), draw.facade()
    elif kind == 1:  # a car
        size = 4.3, draw.uniform(1.3, 1.8), 1.8
        away, material = draw.scale(1, 15), draw.furniture()
    else:  # a table, a bench, a hedge
        size = draw.uniform(0.5, 2.5), draw.scale(0.4, 1.6), draw.uniform(0.4, 1)
        away = draw.scale(0.6, 6)
        hedge = Material(albedo=draw.between(CROWNS), texture=0.4, grain_m=0.3)
        material = hedge if draw.chance(0.3) else draw.furniture()
    reach = away + math.hypot(size[0], size[2]) / 2
    azimuth = draw.uniform(-math.pi, math.pi)
    x, z = reach * math.sin(azimuth), -reach * math.cos(azimuth)
    low = x - size[0] / 2, -eye, z - size[2] / 2
    high = x + size[0] / 2, size[1] - eye, z + size[2] / 2
    return box(low, high, material, turn_rad=azimuth + draw.normal(0, 0.3))
