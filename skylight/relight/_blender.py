"""Blender: light as a script with its .hdr, or a portrait's whole scene for the extension.

The script loads the map as the world and the lamps as suns; the scene has light, camera, head and
photograph, for the extension in ``blender/``.
"""

import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.inverse._result import Lamp
from skylight.io._atomic import atomic_path
from skylight.io._bounded import write_json
from skylight.io._files import write_environment_map, write_png
from skylight.relight._lamps import colour_and_strength, disc_diameter_rad
from skylight.sphere._envmap import EnvironmentMap
from skylight.transport._render import Specular

SCRIPT, TEXTURE = "load_light.py", "blender_light.hdr"
# Blender has +Z up: (x, y, z) here is (x, -z, y) there, as its importers turn models with +Y up.
# The map is turned to Blender's own convention, so that it needs no mapping node.
_SCRIPT = f'''"""Light the scene with {TEXTURE}, which lies beside this file.

Run it as: blender --python {SCRIPT}, or open it in Blender's text editor and press Run. The camera
of the picture looked along Blender's +Y, with +Z up and +X to its right.
"""

from pathlib import Path

import bpy

folder = Path(__file__).parent
text = bpy.data.texts.get("{SCRIPT}")
if text is not None and text.filepath:  # run from the text editor
    folder = Path(bpy.path.abspath(text.filepath)).parent

world = bpy.data.worlds.new("skylight")
if world.node_tree is None:  # before Blender 5 worlds had none of their own accord
    world.use_nodes = True
bpy.context.scene.world = world
nodes, links = world.node_tree.nodes, world.node_tree.links
nodes.clear()
output = nodes.new("ShaderNodeOutputWorld")
background = nodes.new("ShaderNodeBackground")
picture = nodes.new("ShaderNodeTexEnvironment")
picture.image = bpy.data.images.load(str(folder / "{TEXTURE}"))
picture.projection = "EQUIRECTANGULAR"
links.new(picture.outputs["Color"], background.inputs["Color"])
links.new(background.outputs["Background"], output.inputs["Surface"])
'''
# Cycles divides a sun's energy by pi sin^2 of half its angle: however wide it is, its energy is
# the irradiance of a surface that faces it, W / m^2. A sun shines along its -Z.
_SUNS = """
import mathutils

# name, direction towards the lamp, linear colour, irradiance, angular diameter in radians
LAMPS = [
{lamps}]
for name, towards, colour, energy, angle in LAMPS:
    sun = bpy.data.lights.new(name, "SUN")
    sun.color, sun.energy, sun.angle = colour, energy, angle
    lamp = bpy.data.objects.new(name, sun)
    lamp.rotation_euler = mathutils.Vector(towards).to_track_quat("Z", "Y").to_euler()
    lamp.location = [5 * part for part in towards]  # where it is found; its light is parallel
    bpy.context.scene.collection.objects.link(lamp)
"""


def write_blender(
    folder: Path,
    environment: EnvironmentMap,
    lamps: Sequence[Lamp] = (),
    *,
    cd_per_m2: float | None = None,
) -> list[str]:
    """load_light.py and blender_light.hdr; ``lamps`` beside the ``environment`` become suns.

    The world has ``cd_per_m2``, the luminance of a radiance of 1, as a custom property.
    """
    write_environment_map(folder / TEXTURE, environment, convention="blender")
    script = _SCRIPT
    if cd_per_m2 is not None:
        script += f'world["cd_per_m2"] = {cd_per_m2:.9g}  # luminance of a radiance of 1\n'
    if lamps:
        suns = [_sun(number, lamp) for number, lamp in enumerate(lamps, start=1)]
        script += _SUNS.format(lamps="".join(suns))
    with atomic_path(folder / SCRIPT) as temporary:
        temporary.write_text(script, encoding="utf-8")
    return [SCRIPT, TEXTURE]


def in_blenders_axes(direction: Float[Tensor, "3"]) -> tuple[float, float, float]:
    """(x, -z, y): Blender has +Z up, and the camera of the picture looked along its +Y."""
    x, y, z = direction.tolist()
    return x, -z, y


def _sun(number: int, lamp: Lamp) -> str:
    towards = in_blenders_axes(lamp.direction)
    colour, strength = colour_and_strength(lamp.irradiance)
    sun = f"lamp {number}", towards, tuple(colour), strength, disc_diameter_rad(lamp.spread_rad)
    return f"    {sun},\n"


SCENE, PHOTOGRAPH, HEAD = "blender_scene.json", "photograph.png", "head.obj"
KIND, VERSION = "skylight blender scene", 2  # the extension reads these alone
WHITE_PAINT = 0.8  # reflectance of walls and paper that are called white


@dataclass(frozen=True, kw_only=True)
class PortraitScene:
    """What was around and before a camera that looks along -Z, level, from the origin.

    ``ambient`` is the light without the ``lamps``, each with its name. ``photograph`` has sRGB's
    codes, upright; the camera's centre is its middle and ``focal_px`` its focal length. ``head``
    is the .obj of the face, in metres, ``albedo`` its mean reflectance and ``specular`` its
    specular lobe; ``white`` the linear value that the photograph shows of white paint which faces
    the camera; ``cd_per_m2`` the luminance of a radiance of 1. ``verdict`` and ``advice`` tell how
    far to trust the light.
    """

    ambient: EnvironmentMap
    lamps: Sequence[tuple[str, Lamp]]
    photograph: UInt8[np.ndarray, "h w 3"]
    focal_px: float
    head: Path
    albedo: Float[Tensor, "3"]
    specular: Specular
    white: Float[Tensor, "3"]
    verdict: str
    advice: Sequence[str]
    cd_per_m2: float | None = None


def write_blender_scene(folder: Path, scene: PortraitScene) -> list[str]:
    """blender_scene.json, blender_light.hdr, photograph.png and head.obj.

    Directions are in Blender's axes; the .obj has its format's usual ones, +Y up.
    """
    write_environment_map(folder / TEXTURE, scene.ambient, convention="blender")
    write_png(folder / PHOTOGRAPH, scene.photograph)
    with atomic_path(folder / HEAD) as temporary:
        shutil.copyfile(scene.head, temporary)
    height, width = scene.photograph.shape[:2]
    content = {
        "kind": KIND,
        "version": VERSION,
        "axes": "+Z up; the camera at the origin looks along +Y, +X is the picture's right",
        "world": TEXTURE,
        "cd_per_m2": scene.cd_per_m2,
        "suns": [_describe(name, lamp) for name, lamp in scene.lamps],
        "photograph": PHOTOGRAPH,
        "photograph_px": [width, height],
        "focal_length_px": scene.focal_px,
        "head": HEAD,
        "albedo": scene.albedo.tolist(),
        "ior": _index_of_refraction(scene.specular.f0),
        "roughness": scene.specular.roughness,
        "white": scene.white.tolist(),
        "verdict": scene.verdict,
        "advice": list(scene.advice),
    }
    write_json(folder / SCENE, content)
    return [SCENE, TEXTURE, PHOTOGRAPH, HEAD]


def _index_of_refraction(f0: float) -> float:
    """(1 + r) / (1 - r) with r = sqrt(f0), whose reflectance is f0 at normal incidence."""
    root = math.sqrt(f0)
    return (1 + root) / (1 - root)


def _describe(name: str, lamp: Lamp) -> dict[str, object]:
    """A sun of Blender: its energy is the irradiance of a surface that faces it, however wide."""
    colour, energy = colour_and_strength(lamp.irradiance)
    return {
        "name": name,
        "towards": in_blenders_axes(lamp.direction),
        "colour": colour,
        "energy": energy,
        "angle_rad": disc_diameter_rad(lamp.spread_rad),
    }
