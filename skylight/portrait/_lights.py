"""The light that a portrait is put into: a given map, or the light found, rotated or with its
sun moved."""

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from skylight._names import PLAIN_READING, MapReading
from skylight.errors import InputError
from skylight.estimation._kept import FoundLight
from skylight.inverse._lamp_relighting import lamps_radiance
from skylight.inverse._result import Lamp
from skylight.io._files import read_environment_map
from skylight.portrait._edge import EdgeLight
from skylight.portrait._relit import light_in_photo
from skylight.relight._lamps import split_main_light, without_lamps
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import direction_from_angles
from skylight.transport._render import SMOOTH_HEIGHT

# A sun where none was found: its irradiance over that of a horizontal surface by the sky, as under
# a clear sky with the sun halfway up (Hosek-Wilkie, turbidity 3: 5 to 6).
ADDED_SUN = 5.0


@dataclass(frozen=True, kw_only=True)
class NewLight:
    """A full map in the camera's frame and the photograph's units, and what to know of it.

    ``edge`` is a lamp behind the sitter that is not in the map.
    """

    environment: EnvironmentMap
    edge: EdgeLight | None = None
    notes: tuple[str, ...] = ()


def light_of_map(path: Path, reading: MapReading = PLAIN_READING) -> NewLight:
    """A full lat-long map, in whatever units.

    Raises
    ------
    InputError
        No map can be read, or it is a sky alone, too small, or black.
    """
    environment = read_environment_map(path, **vars(reading))
    if environment.is_sky:
        raise InputError(
            f"{path}: a sky without its lower half; give a full lat-long map, twice as wide as high"
        )
    if environment.layout[0] < SMOOTH_HEIGHT:
        raise InputError(
            f"{path}: {environment.layout[0]} rows are too few for shadows: give a map of "
            f"{SMOOTH_HEIGHT} or more"
        )
    if float(environment.radiance.sum()) <= 0:
        raise InputError(f"{path}: the map is black; give one with light in it")
    if float(environment.flat[environment.grid.directions[:, 1] > 0].sum()) <= 0:
        return NewLight(
            environment=environment, notes=("the map's sky is black: all its light is from below",)
        )
    return NewLight(environment=environment)


def rotated_light(estimate: FoundLight, turn_deg: float) -> NewLight:
    """The light found, rotated about the vertical: positive angles move it to the right ahead."""
    return NewLight(environment=light_in_photo(estimate).rotate_azimuth(math.radians(turn_deg)))


@dataclass(frozen=True, kw_only=True)
class MovableSun:
    """The light found, in the photograph's colours and units, as its sun (or its main lamp) and all
    that is ``rest``.

    ``irradiance`` (3,) is what a surface that faces the sun receives, and ``level`` the luminance
    of what a horizontal one receives of the rest. Where no sun ``was_found`` it is one of the
    rest's mean colour and :data:`ADDED_SUN` times that level, in the brightest direction. A lamp
    is as wide as it was found, ``spread_rad`` of :class:`~skylight.inverse._result.Lamp`; a sun,
    None, stands in up to four pixels of the map.
    """

    direction: Float[Tensor, "3"]
    irradiance: Float[Tensor, "3"]
    rest: EnvironmentMap
    level: float
    was_found: bool
    spread_rad: float | None = None

    @staticmethod
    def of(estimate: FoundLight) -> "MovableSun":
        spread_rad = None
        if estimate.lamps:
            main = estimate.lamps[0]
            spread_rad = main.spread_rad
            direction, irradiance = main.direction.double(), main.irradiance.double()
            rest = without_lamps(estimate.environment, [main])
        else:
            sun, rest = split_main_light(estimate.environment)
            direction, irradiance = sun.direction, sun.irradiance
        irradiance = estimate.white_balance.double() * irradiance
        rest = light_in_photo(estimate, rest)
        level = float(luminance(rest.irradiance(torch.tensor([0.0, 1.0, 0.0])).double()))
        was_found = float(irradiance.sum()) > 0
        if not was_found:
            colour = rest.integrate().double()
            irradiance = colour * (ADDED_SUN * level / luminance(colour))
        return MovableSun(
            direction=direction,
            irradiance=irradiance,
            rest=rest,
            level=level,
            was_found=was_found,
            spread_rad=spread_rad,
        )

    def at(self, direction: Float[Tensor, "3"], strength: float | None = None) -> EnvironmentMap:
        """The map with the sun there, of its own or another strength."""
        share = 1.0
        if strength is not None:
            share = strength * self.level / float(luminance(self.irradiance))
        irradiance = share * self.irradiance
        if self.spread_rad is None:
            return self.rest.with_light(direction, irradiance)
        lamp = Lamp(direction=direction, irradiance=irradiance, spread_rad=self.spread_rad)
        lobe = lamps_radiance([lamp], self.rest.layout[0]).reshape(self.rest.radiance.shape)
        return EnvironmentMap(radiance=self.rest.radiance + lobe.to(self.rest.radiance))


def light_with_sun_at(
    estimate: FoundLight, azimuth_deg: float, elevation_deg: float, strength: float | None = None
) -> NewLight:
    """The light found, with its sun (or its main lamp) at another place.

    Its irradiance and colour stay, unless ``strength`` gives its luminance as a multiple of the
    irradiance of a horizontal surface by all other light. Where no sun was found, one of that
    light's mean colour is added, by default of :data:`ADDED_SUN` times.

    Raises
    ------
    InputError
        The sun would stand below the horizon, or its strength is negative.
    """
    if strength is not None and not 0 <= strength < math.inf:
        raise InputError(f"the sun's strength must be 0 or more, got {strength:g}")
    if not -90 <= elevation_deg <= 90:
        raise InputError(f"an elevation lies between -90 and 90 degrees, got {elevation_deg:g}")
    if not estimate.lamps and elevation_deg <= 0:
        raise InputError(
            f"a sun at {elevation_deg:g} degrees has set: give an elevation above 0 degrees"
        )
    angles = azimuth_deg, 90.0 - elevation_deg
    direction = direction_from_angles(
        *(torch.tensor(math.radians(angle), dtype=torch.float64) for angle in angles)
    )
    sun = MovableSun.of(estimate)
    notes: tuple[str, ...] = ()
    if not sun.was_found and strength is None:
        line = (
            f"no sun was found: one is added, of {ADDED_SUN:g} times the other light's irradiance"
        )
        notes = (line,)
    return NewLight(environment=sun.at(direction, strength), notes=notes)
