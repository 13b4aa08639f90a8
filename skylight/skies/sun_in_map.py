"""The sun in a captured sky: position, visibility, clipping.

The threshold lies in a gap between published outdoor maps of known content: with a visible
sun, 35 % and more of the light that a plane facing the brightest place receives comes from
within 4 degrees of it; with none, 12 % and less.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import ndimage
from torch import Tensor

from skylight.sphere.envmap import EnvironmentMap, luminance
from skylight.sphere.frame import angles_from_direction

VISIBLE_SHARE = 0.25
_NEAR_RAD = math.radians(4)
# A sun that a sensor or a format cut off is a plateau of equal pixels. One that is not is at
# most one pixel, or four where a small map was enlarged by repeating its pixels.
PLATEAU_PIXELS = 5
_EQUAL = 1e-6
# The top of a smooth sky is a plateau too, since formats round: by 0.4 % in RGBE's eight bits.
# What was cut off goes down by more than such a step at its border.
_BORDER = 0.99


@dataclass(frozen=True, kw_only=True)
class MapSun:
    """The brightest place of a sky (radians), and whether it is a sun that is visible."""

    azimuth_rad: float
    zenith_rad: float
    visible: bool


def find_sun(sky: EnvironmentMap) -> MapSun:
    """The sun is the brightest place, and visible where it gives enough of the light.

    That is, where sum_near L <w, s>+ dw > :data:`VISIBLE_SHARE` sum_all L <w, s>+ dw, with
    ``near`` the directions w within 4 degrees of the brightest one, s.
    """
    sun = sky.brightest_direction()
    azimuth, zenith = angles_from_direction(sun)
    cosine = (sky.grid.directions @ sun).clamp(min=0)
    received = luminance(sky.flat).double() * sky.grid.solid_angles * cosine
    share = float(received[cosine > math.cos(_NEAR_RAD)].sum() / received.sum())
    return MapSun(
        azimuth_rad=float(azimuth), zenith_rad=float(zenith), visible=share > VISIBLE_SHARE
    )


def plateau_size(pixels: Float[Tensor, "h w 3"], *, wraps: bool) -> int:
    """Pixels of the largest flat plateau at the top: connected, all channels at their largest.

    ``wraps``: the left and right borders touch, as in lat-long maps. 0 where no pixel has all
    channels at their largest values, and where the plateau is a smooth sky's top.
    """
    full = (pixels >= pixels.amax((0, 1)) * (1 - _EQUAL)).all(-1).numpy()
    if not full.any():
        return 0
    light = luminance(pixels.double()).numpy()
    if wraps:  # the emptiest column goes to the border, where it cuts the fewest
        cut = -int(full.sum(0).argmin())
        full, light = (np.roll(image, cut, axis=1) for image in (full, light))
    neighbours = np.ones((3, 3))
    labels, count = ndimage.label(full, structure=neighbours)  # type: ignore[misc]
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    plateau = labels == 1 + sizes.argmax()
    border = ndimage.binary_dilation(plateau, structure=neighbours) & ~plateau
    if not border.any() or light[border].mean() > _BORDER * light[plateau].mean():
        return 0
    return int(plateau.sum())
