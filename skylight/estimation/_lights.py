"""What shines in an estimate's map, as lights of their own: its sun, or its lamps."""

import math
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from skylight._figures import named_angles
from skylight.inverse._result import Estimate
from skylight.relight._lamps import disc_diameter_rad, split_main_light, without_lamps
from skylight.skies._sun import SUN_RADIUS_RAD
from skylight.sphere._envmap import EnvironmentMap


@dataclass(frozen=True, kw_only=True)
class SeparateLight:
    """A sun or lamp: unit ``direction``, ``irradiance`` of a surface that faces it, in the map's
    units, and the angular radius of the disc that stands for it."""

    kind: str
    direction: Float[Tensor, "3"]
    irradiance: Float[Tensor, "3"]
    radius_rad: float

    def described(self) -> dict[str, object]:
        """As estimate.json and the header of probe.exr have it."""
        return {
            "kind": self.kind,
            "direction": self.direction.tolist(),
            **named_angles(self.direction),
            "irradiance": self.irradiance.tolist(),
            "angular_radius_deg": math.degrees(self.radius_rad),
        }


def lights_apart(estimate: Estimate) -> tuple[EnvironmentMap, list[SeparateLight]]:
    """(the map without its lights, these), the strongest first.

    The lamps of a model that has some, as :func:`without_lamps` has it; of a sky its sun where
    one is visible (:func:`split_main_light`), as wide as the sun is.
    """
    whole = estimate.environment
    if estimate.lamps:
        lamps = [
            SeparateLight(
                kind="sun" if lamp.is_sun else "lamp",
                direction=lamp.direction,
                irradiance=lamp.irradiance,
                radius_rad=disc_diameter_rad(lamp.spread_rad) / 2,
            )
            for lamp in estimate.lamps
        ]
        return without_lamps(whole, estimate.lamps), lamps
    if not estimate.posterior.is_seen or estimate.posterior.grid.is_sphere:
        return whole, []
    sun, rest = split_main_light(whole)
    if not sun.visible:
        return whole, []
    radius = float(SUN_RADIUS_RAD)
    return rest, [
        SeparateLight(
            kind="sun", direction=sun.direction, irradiance=sun.irradiance, radius_rad=radius
        )
    ]
