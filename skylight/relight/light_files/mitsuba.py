"""Mitsuba 3: a scene of three balls lit by the map and its lamps."""

from collections.abc import Sequence
from pathlib import Path

from skylight.inverse.result import Lamp
from skylight.io.atomic import atomic_path
from skylight.io.files import write_environment_map
from skylight.sphere.envmap import EnvironmentMap

SCENE, TEXTURE = "scene.xml", "mitsuba_light.exr"
# The map is turned to Mitsuba's own convention, so that the emitter needs no to_world.
_SCENE = f"""<?xml version="1.0" encoding="utf-8"?>
<!-- Light by skylight: right-handed, +Y up, the camera of the picture looked along -Z.
     mitsuba scene.xml renders a mirror, a rough metal and a matt ball in it. -->
<scene version="3.0.0">
    <default name="spp" value="64"/>
    <default name="width" value="384"/>
    <default name="height" value="128"/>

    <emitter type="envmap" id="light">
        <string name="filename" value="{TEXTURE}"/>
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
    folder: Path, environment: EnvironmentMap, lamps: Sequence[Lamp] = ()
) -> list[str]:
    """scene.xml and mitsuba_light.exr, which lies beside it.

    ``lamps`` beside the ``environment`` are directional emitters, which have no width.
    """
    write_environment_map(folder / TEXTURE, environment, convention="mitsuba")
    emitters = [_directional(number, lamp) for number, lamp in enumerate(lamps, start=1)]
    scene = _SCENE.replace("LAMPS", "".join(emitters))
    with atomic_path(folder / SCENE) as temporary:
        temporary.write_text(scene, encoding="utf-8")
    return [SCENE, TEXTURE]


def _directional(number: int, lamp: Lamp) -> str:
    """``direction`` is that of propagation, ``irradiance`` of a surface that faces the lamp."""
    x, y, z = (-lamp.direction).tolist()
    colour = ", ".join(f"{channel:.9g}" for channel in lamp.irradiance.tolist())
    return f"""
    <emitter type="directional" id="lamp_{number}">
        <vector name="direction" x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>
        <rgb name="irradiance" value="{colour}"/>
    </emitter>
"""
