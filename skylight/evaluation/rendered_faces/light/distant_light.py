"""Light from far away: a map of all but the sun, and the sun as a disc of its true size."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from skylight.skies.sun import SUN_RADIUS_RAD
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.frame import angle_between

_SUN_M = 1000.0  # how far off the sun stands: to a head, its parallax is below 0.01 degrees


@dataclass(frozen=True, kw_only=True)
class SunDisc:
    """The sun in the unit ``direction``, of one radiance over its disc of 0.2667 degrees radius.

    ``irradiance`` is what a plane that faces it receives. The true disc is darker towards its limb
    (1 - 0.6 (1 - cos psi), Cox 2000): its penumbra is as wide, and differs by less than 3 % of the
    sun's irradiance anywhere.
    """

    direction: Float[Tensor, "3"]
    irradiance: Float[Tensor, "3"]

    @property
    def radiance(self) -> Float[Tensor, "3"]:
        """E / (pi sin^2 a) over the disc of radius a."""
        return self.irradiance / (math.pi * math.sin(SUN_RADIUS_RAD) ** 2)

    def emitter(
        self, mi, towards: Float[ndarray, "3"], direction: Float[ndarray, "3"]
    ) -> dict[str, object]:
        """Mitsuba's description: a far disc in ``direction`` that faces the point ``towards``."""
        place = towards + _SUN_M * direction
        up = np.eye(3)[np.abs(direction).argmin()]
        turned = mi.ScalarTransform4f().look_at(
            origin=place.tolist(), target=towards.tolist(), up=up.tolist()
        )
        radiance = {"type": "rgb", "value": self.radiance.tolist()}
        return {
            "type": "disk",
            "to_world": turned.scale(_SUN_M * math.tan(SUN_RADIUS_RAD)),
            "emitter": {"type": "area", "radiance": radiance},
        }

    def in_pixels(self, rays: Float[Tensor, "*s 3"], pixel_rad: float) -> Float[Tensor, "*s 3"]:
        """Its radiance in pixels of that angular size, those on its limb covered in part."""
        inside = SUN_RADIUS_RAD - angle_between(rays, self.direction.to(rays).expand_as(rays))
        share = (inside / pixel_rad + 0.5).clamp(0, 1)
        return share[..., None] * self.radiance.to(rays)


@dataclass(frozen=True)
class DistantLight:
    """``diffuse`` is a full map of what comes from everywhere; ``sun`` None where none is visible.

    Under a map of which the sun is not known apart it is in ``diffuse``, as wide as its pixels.
    """

    diffuse: EnvironmentMap
    sun: SunDisc | None = None

    @cached_property
    def environment(self) -> EnvironmentMap:
        """The map of all light, of :meth:`~skylight.sphere.envmap.EnvironmentMap.with_light`."""
        if self.sun is None:
            return self.diffuse
        return self.diffuse.with_light(self.sun.direction, self.sun.irradiance)


def camera_frame(
    direction: Float[Tensor, "3"], world_from_camera: Float[ndarray, "3 3"] | None
) -> Float[ndarray, "3"]:
    """A direction in the world as a turned camera has it."""
    own = direction.double().numpy()
    return own if world_from_camera is None else world_from_camera.T @ own
