"""What the viewer of a scene sees: the map of all that is round him, and its distinct lights.

Suns, and lamps and panels that are smaller than a pixel, are left out of the map and stand beside
it, so that nothing aliases.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.places._radiosity import LIFT, Lit, focused
from skylight.places._scene import Scene
from skylight.skies._sun import SUN_RADIUS_RAD
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid, row_edges_cos

ACROSS = 4  # rays along each side of a pixel
MOST_LIGHTS = 6
LEAST_SHARE = 0.005  # of all light: less is no light of its own
PANEL_POINTS = 256  # on each rectangle of a light


@dataclass(frozen=True, kw_only=True)
class DistinctLight:
    """The sun, a lamp or a window as the viewer sees it.

    ``energy`` is radiance times steradians; ``radius_rad`` that of a disc with the same mean square
    distance from the ``direction``. ``in_map``: it is larger than a pixel and in the map as well.
    """

    kind: str
    direction: Float[Tensor, "3"]
    energy: Float[Tensor, "3"]
    radius_rad: float
    in_map: bool


@dataclass(frozen=True, kw_only=True)
class Rendered:
    """``map`` plus the lights that are not ``in_map``; the mean luminance of both is 1.

    ``level`` is the mean luminance before, in the unit of skies over steradians.
    """

    map: EnvironmentMap
    lights: list[DistinctLight]
    level: float


def render(scene: Scene, *, height: int = 64, generator: torch.Generator) -> Rendered:
    """The map that the viewer of a scene sees, and its distinct lights."""
    room = Lit(scene, generator)
    lights = distinct(room, math.pi / height)
    small = {number for number, light in lights if not light.in_map}
    radiance = _seen(room, height, small)
    grid = DirectionGrid.latlong(height)
    solid = grid.solid_angles.float()
    for number, light in lights:
        if number is None and light.in_map:  # a lamp nearby
            radiance = radiance + spread_out(light, grid, math.pi / height)
    bright = float(luminance(radiance) @ solid)
    bright += sum(float(luminance(light.energy)) for _, light in lights if not light.in_map)
    wanted = [pair for pair in lights if float(luminance(pair[1].energy)) > LEAST_SHARE * bright]
    wanted.sort(key=lambda pair: -float(luminance(pair[1].energy)))
    kept = [light for _, light in wanted[:MOST_LIGHTS]]
    here = {id(light) for light in kept}
    for _, light in lights:
        if not light.in_map and id(light) not in here:
            radiance = radiance + spread_out(light, grid, math.pi / height)
    level = bright / (4 * math.pi)
    if not level > 0:
        raise ValueError("a scene without light has no map")
    return Rendered(
        map=EnvironmentMap(radiance=(radiance / level).reshape(height, 2 * height, 3)),
        lights=[replace(light, energy=light.energy / level) for light in kept],
        level=level,
    )


def spread_out(light: DistinctLight, grid: DirectionGrid, pixel_rad: float) -> Float[Tensor, "n 3"]:
    """A light as a lobe of its energy on a map; one of a pixel where it is smaller.

    ``exp(-(|w - d| / r)^2)``, whose mean square distance is that of a disc of radius sqrt(2) r.
    """
    radius = max(light.radius_rad / math.sqrt(2), pixel_rad)
    lobe = torch.exp(-((grid.directions.float() - light.direction).norm(dim=1) / radius).square())
    lobe = lobe / (lobe @ grid.solid_angles.float())
    return lobe[:, None] * light.energy


def distinct(room: Lit, pixel_rad: float) -> list[tuple[int | None, DistinctLight]]:
    """(number of a panel's lamp, light) of all that the viewer sees; None of suns and lamps."""
    found: list[tuple[int | None, DistinctLight]] = []
    origin = torch.zeros(1, 3)
    outside = room.scene.outside
    energy = outside.sun_irradiance * outside.sunny * room.glass
    if float(energy.sum()) > 0 and float(room.surfaces.free(origin, room.sun[None])[0]):
        found.append((None, _light("sun", room.sun, energy, SUN_RADIUS_RAD, pixel_rad)))
    for lamp in room.scene.lamps:
        at = torch.tensor(np.asarray(lamp.position), dtype=torch.float32)
        distance = float(at.norm())
        seen = room.surfaces.reaches(origin.expand(16, 3), room.on_lamp(lamp, 16)).mean()
        sent = torch.tensor(np.asarray(lamp.intensity)).float() / distance**2
        energy = sent * float(seen) * float(focused(lamp, -at[None] / distance)[0])
        if float(energy.sum()) > 0:
            radius = math.atan(lamp.radius_m / distance)
            found.append((None, _light("lamp", at / distance, energy, radius, pixel_rad)))
    for number in sorted({each for each in room.numbers if each is not None}):
        parts = [k for k, each in enumerate(room.numbers) if each == number]
        light = _panel(room, torch.tensor(parts), pixel_rad)
        if light is not None:
            found.append((number, light))
    return found


def _panel(room: Lit, parts: Int[Tensor, " k"], pixel_rad: float) -> DistinctLight | None:
    """The rectangles of one lamp or window as one light, by points on each."""
    which = parts.repeat_interleave(PANEL_POINTS)
    target = room.panels.at(which, *torch.rand(2, len(which), generator=room.generator))
    distance = target.norm(dim=1)
    way = target / distance[:, None]
    solid = -(way * room.panels.normal[which]).sum(1).clamp(max=0)
    solid = solid * room.panels.area[which] / PANEL_POINTS / distance.square().clamp(min=1e-4)
    solid = solid * room.surfaces.reaches(torch.zeros(len(which), 3), target)
    window = room.is_window[which]
    sent = torch.where(window[:, None], room.outside(way), room.panels.radiance[which])
    energy = (solid[:, None] * sent).sum(0)
    bright = luminance(sent) * solid
    if not float(bright.sum()) > 0:
        return None
    middle = (bright[:, None] * way).sum(0)
    direction = middle / middle.norm()
    square = (bright * (way - direction).square().sum(1)).sum() / bright.sum()
    kind = "window" if bool(window[0]) else "lamp"
    return _light(kind, direction, energy, math.sqrt(2 * float(square)), pixel_rad)


def _light(
    kind: str, direction: Tensor, energy: Tensor, radius_rad: float, pixel_rad: float
) -> DistinctLight:
    return DistinctLight(
        kind=kind,
        direction=direction,
        energy=energy,
        radius_rad=radius_rad,
        in_map=kind != "sun" and radius_rad > pixel_rad,
    )


def _seen(room: Lit, height: int, small: set[int | None]) -> Float[Tensor, "n 3"]:
    """The map without the sun, lamps, and the panels of ``small`` numbers.

    Each surface in each pixel is shaded once, in the middle of where the pixel's rays meet it;
    how much of it is in the sun is known for each ray.
    """
    directions = _pixel_rays(height, room.generator)
    count = ACROSS**2
    pixel = torch.arange(2 * height * height).repeat_interleave(count)
    which, where = room.surfaces.hit(torch.zeros_like(directions), directions)
    light = torch.zeros(2 * height * height, 3)
    gone = which < 0
    light.index_add_(0, pixel[gone], room.outside(directions[gone]) / count)
    if bool(gone.all()):
        return light
    pixel, which, where = pixel[~gone], which[~gone], where[~gone]
    sunny = torch.zeros(len(which))
    if float(room.beam.sum()) > 0:
        normal = room.surfaces.normal[which]
        normal = torch.where((normal * where).sum(1, keepdim=True) > 0, -normal, normal)
        facing = (normal @ room.sun > 0).nonzero()[:, 0]
        sunny[facing] = room.in_sun((where + LIFT * normal)[facing])
    pair, place = torch.unique(pixel * len(room.surfaces) + which, return_inverse=True)
    rays = torch.zeros(len(pair)).index_add_(0, place, torch.ones(len(place)))
    middle = torch.zeros(len(pair), 3).index_add_(0, place, where) / rays[:, None]
    sunny = torch.zeros(len(pair)).index_add_(0, place, sunny) / rays
    owner, which = (
        torch.div(pair, len(room.surfaces), rounding_mode="floor"),
        pair % len(room.surfaces),
    )
    near = _neighbours(pair, len(room.surfaces), height)

    def smooth(values: Float[Tensor, "r 3"]) -> Float[Tensor, "r 3"]:
        padded = torch.cat([values * rays[:, None], torch.zeros(1, 3)])
        weight = torch.cat([rays, torch.zeros(1)])[near].sum(0)
        return padded[near].sum(0) / weight[:, None]

    sent = room.reflected(which, middle, sunny, smooth)
    dark = torch.zeros(len(room.surfaces), dtype=torch.bool)
    for k, number in zip(room.shining.tolist(), room.numbers, strict=False):
        dark[k] = number is not None and number in small
    front = (room.surfaces.normal[which] * middle).sum(1) < 0
    sent = sent + room.surfaces.radiance[which] * (front & ~dark[which])[:, None]
    return light.index_add_(0, owner, sent * (rays / count)[:, None])


def _neighbours(pair: Int[Tensor, " r"], surfaces: int, height: int) -> Int[Tensor, "9 r"]:
    """Where the same surface is in the 3 x 3 pixels about each; r for where it is not.

    ``pair`` is pixel x ``surfaces`` + surface, ascending.
    """
    width = 2 * height
    pixel, surface = torch.div(pair, surfaces, rounding_mode="floor"), pair % surfaces
    row, column = torch.div(pixel, width, rounding_mode="floor"), pixel % width
    found = []
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            wanted = (row + down) * width + (column + right) % width
            wanted = wanted * surfaces + surface
            place = torch.searchsorted(pair, wanted).clamp(max=len(pair) - 1)
            found.append(torch.where(pair[place] == wanted, place, len(pair)))
    return torch.stack(found)


def _pixel_rays(height: int, generator: torch.Generator) -> Float[Tensor, "n 3"]:
    """Directions of :data:`ACROSS` squared rays for each pixel, of equal solid angle, jittered."""
    width = 2 * height
    cells = torch.rand(height, width, ACROSS, ACROSS, 2, generator=generator)
    cells = cells + torch.stack(
        torch.meshgrid(torch.arange(ACROSS), torch.arange(ACROSS), indexing="ij"), -1
    )
    down, along = (cells / ACROSS).unbind(-1)
    edges = row_edges_cos(height, width).float()
    rows = torch.arange(height)[:, None, None, None]
    cosine = edges[rows] + down * (edges[rows + 1] - edges[rows])
    columns = torch.arange(width)[None, :, None, None]
    azimuth = ((columns + along) / width - 0.5) * 2 * math.pi
    sine = (1 - cosine.square()).clamp(min=0).sqrt()
    directions = torch.stack([sine * azimuth.sin(), cosine, -sine * azimuth.cos()], -1)
    return directions.reshape(-1, 3)
