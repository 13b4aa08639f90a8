"""The light that a portrait is put into: a given map, or the light found, turned or with its sun
moved."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from skylight.errors import InputError
from skylight.inverse.lamps.relighting import LampLight
from skylight.inverse.portrait.photograph import light_in_photo
from skylight.inverse.result import Estimate
from skylight.io.files import read_environment_map
from skylight.relight.main_light import split_main_light
from skylight.sphere.envmap import EnvironmentMap, luminance
from skylight.sphere.frame import direction_from_angles

# A sun where none was found: its irradiance over that of a horizontal surface by the sky, as under
# a clear sky with the sun halfway up (Hosek-Wilkie, turbidity 3: 5 to 6).
ADDED_SUN = 5.0


@dataclass(frozen=True, kw_only=True)
class NewLight:
    """A full map in the camera's frame and the photograph's units, and what to know of it."""

    environment: EnvironmentMap
    notes: tuple[str, ...] = ()


def light_of_map(path: Path) -> NewLight:
    """A full lat-long map, in whatever units.

    Raises
    ------
    InputError
        No map can be read, or it is a sky alone, or black.
    """
    environment = read_environment_map(path)
    if environment.is_sky:
        raise InputError(
            f"{path}: a sky without its lower half; give a full lat-long map, twice as wide as high"
        )
    if float(environment.radiance.sum()) <= 0:
        raise InputError(f"{path}: the map is black; give one with light in it")
    if float(environment.upper().radiance.sum()) <= 0:
        return NewLight(
            environment=environment, notes=("the map's sky is black: all its light is from below",)
        )
    return NewLight(environment=environment)


def turned_light(estimate: Estimate, turn_deg: float) -> NewLight:
    """The light found, turned about the vertical: positive angles move it to the right ahead."""
    return NewLight(environment=light_in_photo(estimate).rotate_azimuth(math.radians(turn_deg)))


def light_with_sun_at(
    estimate: Estimate, azimuth_deg: float, elevation_deg: float, strength: float | None = None
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
    notes: tuple[str, ...] = ()
    if estimate.lamps:
        light = LampLight.of(estimate)
        main, others = light.lamps[0], light.lamps[1:]
        rows = estimate.environment.layout[0]
        irradiance = main.irradiance.double()
        rest = replace(light, lamps=others).environment(rows)
    else:
        main, rest = split_main_light(estimate.environment)
        irradiance = main.irradiance
    level = luminance(rest.irradiance(torch.tensor([0.0, 1.0, 0.0])).double())
    if float(irradiance.sum()) == 0:
        irradiance = rest.integrate().double()  # of which only the colour counts
        if strength is None:
            strength = ADDED_SUN
            notes = (f"no sun was found: one is added, of {strength:g} times the sky's irradiance",)
    if strength is not None:
        irradiance = irradiance * (strength * level / luminance(irradiance))
    moved = rest.with_light(direction, irradiance)
    return NewLight(environment=light_in_photo(estimate, moved), notes=notes)
