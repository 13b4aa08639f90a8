"""Compact lights of any map: the sun, lamps and windows, found and taken out of it."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from scipy import ndimage
from torch import Tensor

from skylight.inverse._result import Lamp
from skylight.skies._sun import PLATEAU_PIXELS, SUN_RADIUS_RAD, plateau_size
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import angle_between

WIDEST_RAD = math.radians(20)  # from a light's middle; what is wider is no compact light
LEAST_SHARE = 0.1  # of the light on a surface that faces it
_ROUND_RAD = WIDEST_RAD, math.radians(35)  # the surroundings of what may be one
_OVER_SURROUNDINGS = 2.0
_OF_PEAK = 0.02  # a sun's aureole is a thousandth of it
_LOOKED_AT = 12  # brightest places
# Mean square angle over the sum of a pixel's squared sides: a point between four pixels has 1/4,
# and some of the sky's glow beside it.
_UNRESOLVED = 0.32


@dataclass(frozen=True, kw_only=True)
class CompactLights:
    """The ``lamps``, the strongest first, and the ``rest`` of the map.

    ``cut_off``: the map's brightest place is a plateau of equal pixels, as a format or a sensor
    leaves it that ends there; its light is then a lower bound.
    """

    lamps: list[Lamp]
    rest: EnvironmentMap
    cut_off: bool


@dataclass(frozen=True, kw_only=True)
class _Found:
    lamp: Lamp
    excess: Float[Tensor, "h w 3"]
    strength: float


def compact_lights(environment: EnvironmentMap, most: int) -> CompactLights:
    """The ``most`` strongest compact lights of a full map, and the map without them.

    About each of the brightest places, connected pixels p are a light's where luminance exceeds
    twice the surroundings' median and a fiftieth of the place's own, and their neighbours. What
    exceeds the median radiance B round them (each channel's own) is its, and leaves the map::

        e(w) = max(L(w) - B, 0),   V = sum_p e w dw for each channel
        direction d = V_Y / |V_Y| of the luminance's V,   irradiance E = <V, d>

    so that ``rest.irradiance(n) + E <n, d>+`` is the map's irradiance: exactly for n = d, and to
    2 a / (3 pi) E for an angular radius a where n sees a part of the light alone. The width is that
    of a uniform disc with the same mean square angle to d, less that of a pixel; what
    the map does not resolve, discs of up to about a pixel's radius, is taken to be as wide as the
    sun. A glow that touches a stronger light is none of its own.
    A light counts where it is at most :data:`WIDEST_RAD` wide and gives :data:`LEAST_SHARE` of the
    light on a surface that faces it.

    Of a sun's disc in a smooth sky irradiance is right to 2 %, direction to 0.2 degrees where
    pixels are smaller than the disc, else to half a pixel's diagonal.
    """
    if environment.is_sky:
        raise ValueError("a sky alone has no lower half: give a full lat-long map")
    level = luminance(environment.radiance).double()
    left, found = level.clone(), list[_Found]()
    taken = torch.zeros_like(level, dtype=torch.bool)
    for _ in range(_LOOKED_AT if most else 0):
        if not left.max() > _OVER_SURROUNDINGS * level.mean():
            break
        light, mask = _about_brightest(environment, level, left)
        if light is not None and not (mask & taken).any():  # else it is another's glow
            found.append(light)
            taken |= mask
        left[mask] = 0
    chosen = sorted(found, key=lambda light: -light.strength)[:most]
    radiance = environment.radiance.double()
    for light in chosen:
        radiance = radiance - light.excess
    rest = EnvironmentMap(radiance=radiance.clamp(min=0).to(environment.radiance))
    return CompactLights(
        lamps=[light.lamp for light in chosen],
        rest=rest,
        cut_off=bool(chosen) and _is_cut_off(environment),
    )


def _is_cut_off(environment: EnvironmentMap) -> bool:
    """Whether the brightest place is one level over several pixels' solid angle."""
    height, width = environment.layout
    row = int(luminance(environment.radiance).argmax()) // width
    narrow = math.sin(math.pi * (row + 0.5) / height)  # a pixel here, over one at the horizon
    return narrow * plateau_size(environment.radiance, wraps=True) >= PLATEAU_PIXELS


def _about_brightest(
    environment: EnvironmentMap, level: Float[Tensor, "h w"], left: Float[Tensor, "h w"]
) -> tuple[_Found | None, Bool[Tensor, "h w"]]:
    """The light of the brightest place that is ``left``, if it is one, and its pixels."""
    grid, shape = environment.grid, level.shape
    peak = int(left.argmax())
    away = angle_between(grid.directions, grid.directions[peak]).reshape(shape)
    around = level[(away > _ROUND_RAD[0]) & (away < _ROUND_RAD[1])].median()
    brightest = float(level.flatten()[peak])
    threshold = max(_OVER_SURROUNDINGS * float(around), _OF_PEAK * brightest)
    at_peak = away == away.min()
    while True:
        if not threshold < brightest:
            return None, at_peak
        mask = _connected((left > threshold) & (away < 2 * WIDEST_RAD), peak)
        weight = (level * mask).flatten() * grid.solid_angles
        off = angle_between(grid.directions, weight @ grid.directions).reshape(shape)
        if float(off[mask].max()) < WIDEST_RAD:
            break
        threshold *= 1.5
    border = float(off[mask].max()) + 1.5 * math.pi / shape[0]
    ring = (off > border) & (off < border + math.radians(5)) & ~mask
    background = environment.radiance[ring].double().median(0).values
    excess = (environment.radiance.double() - background).clamp(min=0) * mask[..., None]
    vectors = (excess.flatten(0, 1) * grid.solid_angles[:, None]).T @ grid.directions
    direction = luminance(vectors.T)
    direction = direction / direction.norm()
    irradiance = vectors @ direction
    facing = luminance(environment.irradiance(direction).double())
    strength = float(luminance(irradiance))
    if not strength > LEAST_SHARE * float(facing):
        return None, mask
    radius = _disc_radius_rad(environment, luminance(excess).flatten(), direction)
    lamp = Lamp(direction=direction, irradiance=irradiance, spread_rad=radius / 2)
    return _Found(lamp=lamp, excess=excess, strength=strength), mask


def _connected(bright: Bool[Tensor, "h w"], peak: int) -> Bool[Tensor, "h w"]:
    """The bright pixels that hang together with that one, and what touches them."""
    width = bright.shape[1]
    row, column = divmod(peak, width)
    turn = width // 2 - column  # away from the seam; a row at a pole hangs together by itself
    touching = torch.ones(3, 3, dtype=torch.bool).numpy()
    labels, _ = ndimage.label(bright.roll(turn, 1).numpy(), structure=touching)  # type: ignore[misc]
    mine = ndimage.binary_dilation(labels == labels[row, width // 2], structure=touching)
    return torch.from_numpy(mine).roll(-turn, 1)


def _disc_radius_rad(
    environment: EnvironmentMap, light: Float[Tensor, " n"], direction: Float[Tensor, "3"]
) -> float:
    """Of the uniform disc as wide: its mean square angle is half its squared radius."""
    grid = environment.grid
    height, width = environment.layout
    weight = light * grid.solid_angles
    weight = weight / weight.sum()
    square = float(weight @ angle_between(grid.directions, direction).square())
    across = 2 * math.pi / width * math.sqrt(max(0.0, 1 - float(direction[1]) ** 2))
    pixel = (math.pi / height) ** 2 + across**2
    if square < _UNRESOLVED * pixel:
        return float(SUN_RADIUS_RAD)
    return math.sqrt(2 * (square - pixel / 12))
