"""Mitsuba 3: a scene of three balls lit by the map and its lamps.

Nine spherical harmonic coefficients as JSON, in a named convention.
"""

from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.inverse._result import Lamp
from skylight.io._atomic import atomic_path
from skylight.io._bounded import write_json
from skylight.io._files import write_environment_map
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._harmonics import project, to_convention
from skylight.sphere._names import HarmonicConvention

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


HARMONICS = "sh27.json"
_STANDS_FOR = {
    "skylight": "radiance, RGB by coefficient (0,0) (1,-1) (1,0) (1,1) (2,-2) ... (2,2)",
    "threejs": "radiance, RGB by coefficient (0,0) (1,-1) (1,0) (1,1) (2,-2) ... (2,2)",
    "arcore": "radiance, RGB by coefficient, a minus for odd m (Condon-Shortley)",
    "arkit": "radiance, nine of red, nine of green, nine of blue",
    "gltf": "irradiance, RGB by coefficient, a minus for negative m",
}


def second_degree(environment: EnvironmentMap) -> Float[Tensor, "9 3"]:
    """Coefficients of radiance up to degree 2 in :mod:`skylight.sphere._harmonics`' basis."""
    return project(environment.flat.double(), environment.grid, 2)


def rounded(coefficients: Float[Tensor, "9 3"], convention: HarmonicConvention) -> list[float]:
    """As float32 has them, which is what their readers store."""
    return to_convention(coefficients, convention).to(torch.float32).tolist()


def write_harmonics(
    folder: Path, environment: EnvironmentMap, convention: HarmonicConvention
) -> list[str]:
    """sh27.json: the numbers, and what they stand for."""
    content = {
        "format": "skylight sh27 1",
        "convention": convention,
        "numbers_are": _STANDS_FOR[convention],
        "axes": "right-handed, +Y up, the camera looks along -Z",
        "sh": rounded(second_degree(environment), convention),
    }
    write_json(folder / HARMONICS, content)
    return [HARMONICS]
