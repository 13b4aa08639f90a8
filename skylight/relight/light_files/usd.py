"""USD: a DomeLight with its lat-long texture, and a DistantLight for each lamp."""

import math
from collections.abc import Sequence
from pathlib import Path

from skylight.inverse.result import Lamp
from skylight.io.atomic import atomic_path
from skylight.io.files import write_environment_map
from skylight.relight.lamp_lights import (
    colour_and_strength,
    disc_diameter_rad,
    quaternion_towards,
)
from skylight.sphere.envmap import EnvironmentMap

LAYER, TEXTURE = "light.usda", "usd_light.exr"
_HEAD = """#usda 1.0
(
    defaultPrim = "Light"
    doc = "Light by skylight: right-handed, +Y up, the camera of the picture looked along -Z"
    metersPerUnit = 1
    upAxis = "Y"
)

"""
# UsdLux, DomeLight: "The dome's default orientation is such that its top pole is aligned with the
# world's +Y axis. This adheres to the OpenEXR specification for latitude-longitude maps." What a
# pixel means is radiance times inputs:intensity, in the scene's linear Rec.709.
_DOME = f"""
{{
    float inputs:intensity = 1
    asset inputs:texture:file = @./{TEXTURE}@
    token inputs:texture:format = "latlong"
}}
"""


def write_usd(folder: Path, environment: EnvironmentMap, lamps: Sequence[Lamp] = ()) -> list[str]:
    """light.usda and usd_light.exr, which lies beside it and is turned the way OpenEXR says.

    The default prim is the dome; with ``lamps`` beside the ``environment``, it is an Xform of the
    dome and a DistantLight for each lamp.
    """
    write_environment_map(folder / TEXTURE, environment, convention="openexr")
    prims = 'def DomeLight "Light"' + _DOME
    if lamps:
        inside = ['def DomeLight "Rest"' + _DOME]
        inside += [_distant(number, lamp) for number, lamp in enumerate(lamps, start=1)]
        prims = 'def Xform "Light"\n{\n' + "\n".join(map(_indented, inside)) + "}\n"
    with atomic_path(folder / LAYER) as temporary:
        temporary.write_text(_HEAD + prims, encoding="utf-8")
    return [LAYER, TEXTURE]


def _distant(number: int, lamp: Lamp) -> str:
    """A lamp, which shines along its -Z.

    UsdLux, LightAPI: with ``normalize``, a DistantLight's radiance is divided by pi sin^2 of half
    its angle, so that intensity times colour is the irradiance of a surface that faces it.
    """
    colour, strength = colour_and_strength(lamp.irradiance)
    x, y, z, w = quaternion_towards(lamp.direction)
    return f"""def DistantLight "Lamp{number}"
{{
    float inputs:angle = {math.degrees(disc_diameter_rad(lamp.spread_rad)):.9g}
    color3f inputs:color = ({", ".join(f"{channel:.9g}" for channel in colour)})
    float inputs:intensity = {strength:.9g}
    bool inputs:normalize = 1
    quatf xformOp:orient = ({w:.9g}, {x:.9g}, {y:.9g}, {z:.9g})
    uniform token[] xformOpOrder = ["xformOp:orient"]
}}
"""


def _indented(prim: str) -> str:
    return "".join(f"    {line}\n" for line in prim.splitlines())
