"""USD: a DomeLight with its lat-long texture, and a DistantLight for each lamp.

ARCore and ARKit: a main light, ambient harmonics and a cube map.
"""

import math
from collections.abc import Sequence
from pathlib import Path

from skylight.inverse._result import Lamp
from skylight.io._atomic import atomic_path
from skylight.io._bounded import write_json
from skylight.io._files import write_environment_map, write_light
from skylight.relight._lamps import (
    colour_and_strength,
    disc_diameter_rad,
    quaternion_towards,
    split_main_light,
)
from skylight.relight._mitsuba import rounded, second_degree
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._projections import FACES, cube_faces

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


DESCRIPTION = "ar_light.json"


def write_augmented_reality(folder: Path, environment: EnvironmentMap, size: int) -> list[str]:
    """ar_light.json and cube_px.hdr to cube_nz.hdr, faces of ``size`` pixels.

    As Google's sample shader for ARCore's Environmental HDR states it (environmental_hdr.frag),

        E(harmonics) + E(main light) = E(cube map):

    the cube map shows the sun, the harmonics do not. The main light's direction points towards
    it; its intensity is the irradiance of a plane that faces it, so that a matt surface sends
    back albedo / pi * (intensity <n, s>+ + E_harmonics(n)).
    """
    main, rest = split_main_light(environment)
    ambient = second_degree(rest)
    files = {name: f"cube_{name}.hdr" for name in FACES}
    for picture, (name, file) in zip(cube_faces(environment, size), files.items(), strict=True):
        header: dict[str, object] = {"comments": f"cube map, {name}"}
        write_light(folder / file, picture, header=header)
    content = {
        "format": "skylight ar light 1",
        "axes": "right-handed, +Y up, metres; the camera of the picture looked along -Z",
        "main_light": {
            "visible": main.visible,
            "direction_towards_light": main.direction.tolist(),
            "intensity_rgb": main.irradiance.tolist(),
        },
        "ambient_harmonics": {
            "arcore": rounded(ambient, "arcore"),
            "arkit": rounded(ambient, "arkit"),
        },
        "cube_map": {"size": size, "order": list(files.values()), "shows_main_light": True},
    }
    write_json(folder / DESCRIPTION, content)
    return [DESCRIPTION, *files.values()]
