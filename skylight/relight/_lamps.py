"""Lights of their own, and the rest of an environment map.

An estimate's lamps leave its map (:func:`without_lamps`); of any other map the sun becomes one
directional light (:func:`split_main_light`), as in augmented reality. What other programs take of
such a light: its colour and strength, its width as a disc, and its orientation.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.inverse._lamp_relighting import lamps_radiance
from skylight.inverse._result import Lamp
from skylight.skies._sun import find_sun
from skylight.sphere._envmap import SUN_REGION_RAD, EnvironmentMap, luminance
from skylight.sphere._frame import angle_between

# Of the lamps' energy. An estimate's map is ambient light, which is positive, plus its lamps' lobes
# in float32: what is wrong without them is rounding, and below 2e-5 over 300 draws of the prior.
MOST_CLAMPED = 1e-3


def without_lamps(environment: EnvironmentMap, lamps: Sequence[Lamp]) -> EnvironmentMap:
    """The rest of an estimate's map when its lamps are lights of their own, 0 at least::

        rest(w) = max(L(w) - sum_k E_k / f(s_k) g(w; d_k, s_k), 0)

    E_k is the irradiance of a surface that faces lamp k, and g and f are those by which the map was
    made: see :mod:`skylight.inverse._lamp_relighting`.
    """
    if not lamps:
        return environment
    light = lamps_radiance(lamps, environment.layout[0])
    rest = environment.flat.double() - light
    solid_angles = environment.grid.solid_angles
    clamped = float(solid_angles @ rest.clamp(max=0).abs().sum(1))
    if clamped > MOST_CLAMPED * float(solid_angles @ light.sum(1)):
        raise InputError(
            "the map does not hold the light of the estimate's lamps: give the folder as "
            "skylight estimate wrote it, or its map alone"
        )
    kept = rest.clamp(min=0).to(environment.radiance)
    return EnvironmentMap(radiance=kept.reshape(environment.radiance.shape))


def disc_diameter_rad(spread_rad: float) -> float:
    """Angular diameter of the uniform disc that is as wide as a lamp's lobe.

    It has the same mean square chord to the lobe's middle, ``2 (1 - <cos>)``, so both send as much
    light forwards for their energy. With k = 1 / s^2, a von Mises-Fisher lobe's ``<cos>`` is
    coth k - 1 / k, and that of a disc of radius a is (1 + cos a) / 2::

        2 a = 4 asin sqrt(1 - coth k + 1 / k)

    For narrow lamps the chord is the angle: 2 s^2 = a^2 / 2, a diameter of 4 s. Of the irradiance
    of a surface that faces both, surfaces at any slant receive the same to 1.5 % for spreads of up
    to 20 degrees, to 8 % for 40.
    """
    sharpness = spread_rad**-2
    return 4 * math.asin(math.sqrt(1 - 1 / math.tanh(sharpness) + 1 / sharpness))


def colour_and_strength(irradiance: Float[Tensor, "3"]) -> tuple[list[float], float]:
    """A linear colour whose largest channel is 1, as programs take it, times a strength."""
    strength = float(irradiance.max())
    if strength == 0:
        return [1.0, 1.0, 1.0], 0.0
    return (irradiance.double() / strength).tolist(), strength


def quaternion_towards(direction: Float[Tensor, "3"]) -> list[float]:
    """(x, y, z, w) of the shortest turn that takes +Z to a unit vector.

    Lights of glTF and USD shine along their -Z: so turned, one shines from there.
    """
    x, y, z = direction.tolist()
    if 1 + z < 1e-12:  # -Z: half a turn, about +Y as well as about any other level axis
        return [0.0, 1.0, 0.0, 0.0]
    length = math.sqrt(2 * (1 + z))
    return [-y / length, x / length, 0.0, length / 2]


SUN_RADIUS_RAD = math.radians(4.0)  # as far as a map's brightest direction looks


@dataclass(frozen=True, kw_only=True)
class MainLight:
    """Parallel light from ``direction`` (3,), a unit vector towards it.

    ``irradiance`` (3,) is what a plane facing it receives, linear Rec.709, in units of radiance
    times sr: a diffuse surface of albedo a and normal n sends back a / pi irradiance <n, s>+.
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
    (:func:`skylight.skies._sun.find_sun`), the main light is black and the map is whole.
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
