"""Scenes of Mitsuba 3 and USD: text that names the map as a texture, with lamps beside it.

Mitsuba: three balls lit by an environment emitter and directional ones. USD: a DomeLight, and a
DistantLight for each lamp.
"""

import math
from collections.abc import Sequence
from pathlib import Path

from skylight.inverse._result import Lamp
from skylight.io._atomic import atomic_path
from skylight.io._files import write_environment_map
from skylight.relight._lamps import colour_and_strength, disc_diameter_rad, quaternion_towards
from skylight.sphere._envmap import EnvironmentMap

SCENE, MITSUBA_TEXTURE = "scene.xml", "mitsuba_light.exr"
# The map is turned to Mitsuba's own convention, so that the emitter needs no to_world.
_SCENE = f"""<?xml version="1.0" encoding="utf-8"?>
<!-- Light by skylight: right-handed, +Y up, the camera of the picture looked along -Z.
     mitsuba scene.xml renders a mirror, a rough metal and a diffuse ball in it. -->
<scene version="3.0.0">
    <default name="spp" value="64"/>
    <default name="width" value="384"/>
    <default name="height" value="128"/>

    <emitter type="envmap" id="light">
        <string name="filename" value="{MITSUBA_TEXTURE}"/>
    </emitter>
LAMPS
    <integrator type="path">
        <integer name="max_depth" value="6"/>
    </integrator>
    <sensor type="perspective">
        <float name="fov" value="36"/>
        <transform name="to_world">
            <lookat origin="0, 0, 11" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <sampler type="independent">
            <integer name="sample_count" value="$spp"/>
        </sampler>
        <film type="hdrfilm">
            <integer name="width" value="$width"/>
            <integer name="height" value="$height"/>
            <string name="pixel_format" value="rgb"/>
        </film>
    </sensor>

    <shape type="sphere">
        <point name="center" x="-2.4" y="0" z="0"/>
        <bsdf type="conductor">
            <string name="material" value="none"/>
        </bsdf>
    </shape>
    <shape type="sphere">
        <bsdf type="roughconductor">
            <string name="material" value="none"/>
            <string name="distribution" value="ggx"/>
            <float name="alpha" value="0.25"/>
        </bsdf>
    </shape>
    <shape type="sphere">
        <point name="center" x="2.4" y="0" z="0"/>
        <bsdf type="diffuse">
            <rgb name="reflectance" value="0.5"/>
        </bsdf>
    </shape>
</scene>
"""


def write_mitsuba(
    folder: Path,
    environment: EnvironmentMap,
    lamps: Sequence[Lamp] = (),
    *,
    cd_per_m2: float | None = None,
) -> list[str]:
    """scene.xml and mitsuba_light.exr, which lies beside it.

    ``lamps`` beside the ``environment`` are directional emitters, which have no width. The
    texture's header has ``cd_per_m2``, the luminance of a radiance of 1.
    """
    write_environment_map(
        folder / MITSUBA_TEXTURE, environment, convention="mitsuba", header=_unit(cd_per_m2)
    )
    emitters = [_emitter(number, lamp) for number, lamp in enumerate(lamps, start=1)]
    scene = _SCENE.replace("LAMPS", "".join(emitters))
    with atomic_path(folder / SCENE) as temporary:
        temporary.write_text(scene, encoding="utf-8")
    return [SCENE, MITSUBA_TEXTURE]


def _unit(cd_per_m2: float | None) -> dict[str, object]:
    return {} if cd_per_m2 is None else {"whiteLuminance": cd_per_m2}


def _emitter(number: int, lamp: Lamp) -> str:
    """``direction`` is that of propagation, ``irradiance`` of a surface that faces the lamp."""
    x, y, z = (-lamp.direction).tolist()
    colour = ", ".join(f"{channel:.9g}" for channel in lamp.irradiance.tolist())
    return f"""
    <emitter type="directional" id="lamp_{number}">
        <vector name="direction" x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>
        <rgb name="irradiance" value="{colour}"/>
    </emitter>
"""


LAYER, USD_TEXTURE = "light.usda", "usd_light.exr"
_HEAD = """#usda 1.0
(
    UNIT
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
    asset inputs:texture:file = @./{USD_TEXTURE}@
    token inputs:texture:format = "latlong"
}}
"""


def write_usd(
    folder: Path,
    environment: EnvironmentMap,
    lamps: Sequence[Lamp] = (),
    *,
    cd_per_m2: float | None = None,
) -> list[str]:
    """light.usda and usd_light.exr, which lies beside it and is turned the way OpenEXR says.

    The default prim is the dome; with ``lamps`` beside the ``environment``, it is an Xform of the
    dome and a DistantLight for each lamp. ``cd_per_m2``, the luminance of a radiance of 1, is in
    the texture's header and the layer's ``customLayerData``.
    """
    write_environment_map(
        folder / USD_TEXTURE, environment, convention="openexr", header=_unit(cd_per_m2)
    )
    prims = 'def DomeLight "Light"' + _DOME
    if lamps:
        inside = ['def DomeLight "Rest"' + _DOME]
        inside += [_distant(number, lamp) for number, lamp in enumerate(lamps, start=1)]
        prims = 'def Xform "Light"\n{\n' + "\n".join(map(_indented, inside)) + "}\n"
    told = ""
    if cd_per_m2 is not None:
        told = f"    customLayerData = {{\n        double cd_per_m2 = {cd_per_m2:.9g}\n    }}\n"
    with atomic_path(folder / LAYER) as temporary:
        temporary.write_text(_HEAD.replace("    UNIT\n", told) + prims, encoding="utf-8")
    return [LAYER, USD_TEXTURE]


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
