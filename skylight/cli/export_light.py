"""``skylight export light``: environment maps for other programs."""

import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import Positional

from skylight.cli.convert import Convention

# Parsing must not import torch, so the choices stand here again; a test compares the two.
LightTarget = Literal["threejs", "sh", "ar", "gltf", "usd", "mitsuba", "blender"]
HarmonicConvention = Literal["skylight", "threejs", "arcore", "arkit", "gltf"]


def export_light(
    probe: Positional[Path],
    out: Positional[Path],
    as_: Annotated[tuple[LightTarget, ...], tyro.conf.arg(name="as")],
    from_convention: Convention = "skylight",
    sh_convention: HarmonicConvention = "skylight",
    face: int | None = None,
) -> None:
    """Write a map of light the way other programs load it; docs/interchange.md tells how.

    threejs: lightprobe.json, a LightProbe for ObjectLoader. sh: sh27.json, nine spherical
    harmonics. ar: ar_light.json and six .hdr faces, ARCore's and ARKit's main light, ambient
    harmonics and cube map. gltf: light.glb with EXT_lights_image_based. usd: light.usda, a
    DomeLight. mitsuba: scene.xml. blender: load_light.py, which loads the .hdr beside it.

    Given an estimate's folder, the lamps that it lists (of --light lamps, or auto) become lights
    to move and switch, beside the rest of its map: DirectionalLight, KHR_lights_punctual,
    DistantLight, directional emitters, suns. sh and ar have all light in one.

    Args:
        probe: .exr or .hdr lat-long map of the sphere, or of the sky; or the folder that skylight
            estimate wrote, or its estimate.json.
        out: Folder for the files.
        as_: One target or more.
        from_convention: Which program's way of turning lat-long maps the probe has.
        sh_convention: Of sh27.json: signs, order and what the numbers stand for.
        face: Pixels of a cube map's side, a power of two; by default as the map's detail asks.
    """
    from skylight.app.maps.export_light import export_light

    exported = export_light(
        probe, out, as_, convention=from_convention, harmonics=sh_convention, face=face
    )
    print(f"written into {out}: {', '.join(exported.files)}")
    if exported.lamps:
        print(f"lamps that are lights of their own, not in the map: {exported.lamps}")
    if exported.cut > 0.001:
        print(
            f"skylight: take care: reflections of light.glb lack {100 * exported.cut:.1f} % of the "
            "light, cut off at 255 where its format ends; its diffuse light is whole",
            file=sys.stderr,
        )
