"""Directions and lamps in degrees, for people and files."""

import math
from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from skylight.inverse.result import Lamp
from skylight.sphere.frame import angles_from_direction


def angles_deg(direction: Float[Tensor, "3"]) -> tuple[float, float]:
    """(azimuth, zenith) of a direction, degrees."""
    azimuth, zenith = angles_from_direction(direction)
    return math.degrees(float(azimuth)), math.degrees(float(zenith))


def named_angles(direction: Float[Tensor, "3"]) -> dict[str, float]:
    """:func:`angles_deg` as estimate.json has them."""
    return dict(zip(("azimuth_deg", "zenith_deg"), angles_deg(direction), strict=True))


def describe_lamps(lamps: Sequence[Lamp]) -> list[dict[str, object]]:
    """What estimate.json says of them."""
    return [
        {
            **named_angles(lamp.direction),
            "irradiance": lamp.irradiance.tolist(),
            "spread_deg": math.degrees(lamp.spread_rad),
        }
        for lamp in lamps
    ]
