"""Names of the programs for which light is exported, which the command line takes as choices."""

from typing import Literal

LightTarget = Literal["threejs", "sh", "ar", "gltf", "usd", "mitsuba", "blender"]
