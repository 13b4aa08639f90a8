"""An environment map split into one directional light and the rest, as in augmented reality."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.skies.sun_in_map import find_sun
from skylight.sphere.envmap import SUN_REGION_RAD, EnvironmentMap, luminance
from skylight.sphere.frame import angle_between

SUN_RADIUS_RAD = math.radians(4.0)  # as far as a map's brightest direction looks


@dataclass(frozen=True, kw_only=True)
class MainLight:
    """Parallel light from ``direction`` (3,), a unit vector towards it.

    ``irradiance`` (3,) is what a plane facing it receives, linear Rec.709, in units of radiance
    times sr: a matt surface of albedo a and normal n sends back a / pi irradiance <n, s>+.
    """

    direction: Float[Tensor, "3"]
    irradiance: Float[Tensor, "3"]
    visible: bool


def split_main_light(environment: EnvironmentMap) -> tuple[MainLight, EnvironmentMap]:
    """The sun of a full map, and the map without it.

    Within 4 degrees of the brightest direction above the horizon, what exceeds the median
    radiance B (each channel's own) from 4 to 13 degrees round it is the sun's:
    E = sum max(L - B, 0) w dw, a vector for each channel. The light's direction is that of the
    luminance's E, its irradiance ``|E|`` for each channel; the rest stays in the map. So ::

        irradiance(n) = rest.irradiance(n) + main.irradiance <n, s>+

    holds to ``|E| sin(4 deg)`` at worst (normals that see half the sun), and exactly where the
    whole sun is seen and its channels share one centre. Where no sun is visible
    (:func:`skylight.skies.sun_in_map.find_sun`), the main light is black and the map is whole.
    """
    if environment.is_sky:
        raise ValueError("a sky alone has no lower half: give a full lat-long map")
    sun = environment.brightest_direction()
    if not _sun_is_visible(environment):
        black = MainLight(direction=sun, irradiance=torch.zeros(3).double(), visible=False)
        return black, environment
    grid = environment.grid
    angle = angle_between(grid.directions, sun)
    near = angle < SUN_RADIUS_RAD
    # a coarse map has no pixel that near its centroid
    near[angle.argmin()] = True
    around = (angle < SUN_REGION_RAD) & ~near & (grid.directions[:, 1] > 0)
    flat = environment.flat.double()
    background = flat[around].median(0).values if around.any() else torch.zeros(3).double()
    excess = (flat - background).clamp(min=0) * near[:, None]
    vectors = (excess * grid.solid_angles[:, None]).T @ grid.directions  # a row per channel
    towards = luminance(vectors.T)
    main = MainLight(
        direction=towards / towards.norm(), irradiance=vectors.norm(dim=1), visible=True
    )
    rest = (flat - excess).clamp(min=0).to(environment.radiance)
    return main, EnvironmentMap(radiance=rest.reshape(environment.radiance.shape))


def _sun_is_visible(environment: EnvironmentMap) -> bool:
    sky = environment.upper()
    return bool(sky.radiance.sum() > 0) and find_sun(sky).visible
