"""Names of the lights that known objects are explained by."""

from typing import Literal, get_args

# sparse codes of a dictionary, spherical harmonics, lamps in ambient light
ObjectLightName = Literal["ani", "iso", "vmf", "sh9", "sh25", "sh49", "lamps"]
OBJECT_LIGHTS: tuple[ObjectLightName, ...] = get_args(ObjectLightName)
