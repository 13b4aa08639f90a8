"""The sun: its position for a place and a time, and what a captured map shows of it.

A sun counts as visible by the share of the light on a plane that faces the brightest place which
comes from within 4 degrees of it. The threshold lies in a gap between published outdoor maps of
known content: 35 % and more with a visible sun, 12 % and less with none.

Collections of light probes mix skies with rooms, studios and nights; whether a whole lat-long map
shows a sky is judged by the map alone. Without a visible sun, the zenith of published outdoor maps
has a blue of 0.99 of its red and more, that of rooms under lamps mostly 0.90 and less; its
luminance is at least that of the ground, but 0.3 of it and less under a dark ceiling. A night under
lamps or the moon differs from a day by its level alone, which relative maps lack: it is told only
where the lower half outshines the upper.
"""

import math
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from skylight.skies._solar_position import sun_azimuth_zenith
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import angles_from_direction

# Mean angular radius of the solar disc; its solid angle is 6.807e-5 sr.
SUN_RADIUS_RAD = np.radians(0.2667)
VISIBLE_SHARE = 0.25
_NEAR_RAD = math.radians(4)
# A sun that a sensor or a format cut off is a plateau of equal pixels. One that is not is at
# most one pixel, or four where a small map was enlarged by repeating its pixels.
PLATEAU_PIXELS = 5
_EQUAL = 1e-6
# The top of a smooth sky is a plateau too, since formats round: by 0.4 % in RGBE's eight bits.
# What was cut off goes down by more than such a step at its border.
_BORDER = 0.99
ZENITH_RAD = math.radians(30)  # of the cap that counts as the zenith
ROWS = 64  # of the map that is judged
LEAST_BLUE = 0.95  # of its red
LEAST_BRIGHT = 0.5  # of the lower half
LEAST_FROM_ABOVE = 0.7  # of the mean radiance of the lower half
NO_SKY = ("indoor", "night", "studio")  # how such categories of a collection begin


@dataclass(frozen=True, kw_only=True)
class Place:
    """Geographic position: degrees north and east, metres above the sea."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0


def sun_midnight(place: Place, day: date) -> datetime:
    """When a day begins by the place's mean sun time, in UTC: 4 minutes earlier a degree east."""
    return datetime.combine(day, time(), UTC) - timedelta(hours=place.longitude_deg / 15)


def sun_angles(
    place: Place, times: list[datetime]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """True (refraction-free) sun azimuth (clockwise from north) and zenith angle, radians.

    Good to 0.0003 degrees. ``times`` must carry a time zone.
    """
    if any(moment.tzinfo is None for moment in times):
        raise ValueError("sun_angles needs times with a time zone, e.g. datetime(..., tzinfo=UTC)")
    return sun_azimuth_zenith(
        np.array([moment.timestamp() for moment in times]),
        latitude_deg=place.latitude_deg,
        longitude_deg=place.longitude_deg,
        altitude_m=place.altitude_m,
    )


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
    from scipy import ndimage  # slow to import, and estimates do without

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


def why_no_sky(radiance: Float[Tensor, "h w 3"], *, sun_is_visible: bool) -> str | None:
    """Why a map of the whole sphere shows no sky, in words; None where it may show one.

    ::

        median B < 0.95 median R                        in the 30 degrees about the zenith
        median luminance there < 0.5 median below the horizon
        mean luminance of the upper half < 0.7 of the lower one's

    of the map at 64 rows. The first two count only without a visible sun.
    """
    light = EnvironmentMap(radiance=radiance.nan_to_num(0.0, 0.0, 0.0).clamp(min=0))
    if radiance.shape[0] > ROWS:  # leaves and gaps between them become one
        light = light.resize(ROWS)
    half = light.radiance.shape[0] // 2
    zenith = light.radiance[: max(1, round(half * ZENITH_RAD / (math.pi / 2)))].flatten(0, 1)
    below = luminance(light.radiance[half:])
    if not sun_is_visible:
        red, _, blue = zenith.median(0).values
        if blue < LEAST_BLUE * red:
            return "no sky above: the zenith is redder than a sky's"
        if luminance(zenith).median() < LEAST_BRIGHT * below.median():
            return "no sky above: the zenith is darker than what is below"
    weight = light.grid.solid_angles.to(light.flat).reshape(light.radiance.shape[:2])
    energy = (luminance(light.radiance) * weight).double()
    if energy[:half].sum() < LEAST_FROM_ABOVE * energy[half:].sum():
        return "no sky above: most light comes from below the horizon"
    return None
