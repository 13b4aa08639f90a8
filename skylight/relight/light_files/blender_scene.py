"""Blender: a portrait's light, camera, head and photograph, for the extension of blender/."""

import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.inverse.result import Lamp
from skylight.io.atomic import atomic_path
from skylight.io.files import write_environment_map, write_png
from skylight.io.json_files import write_json
from skylight.relight.lamp_lights import colour_and_strength, disc_diameter_rad
from skylight.relight.light_files.blender import TEXTURE, in_blenders_axes
from skylight.sphere.envmap import EnvironmentMap
from skylight.transport.render import Specular

SCENE, PHOTOGRAPH, HEAD = "blender_scene.json", "photograph.png", "head.obj"
KIND, VERSION = "skylight blender scene", 1  # the extension reads these alone


@dataclass(frozen=True, kw_only=True)
class PortraitScene:
    """What was around and before a camera that looks along -Z, level, from the origin.

    ``ambient`` is the light without the ``lamps``, each with its name. ``photograph`` has sRGB's
    codes, upright; the camera's centre is its middle and ``focal_px`` its focal length. ``head``
    is the .obj of the face, in metres, ``albedo`` its mean reflectance and ``specular`` its gloss.
    ``verdict`` and ``advice`` tell how far to trust the light.
    """

    ambient: EnvironmentMap
    lamps: Sequence[tuple[str, Lamp]]
    photograph: UInt8[np.ndarray, "h w 3"]
    focal_px: float
    head: Path
    albedo: Float[Tensor, "3"]
    specular: Specular
    verdict: str
    advice: Sequence[str]


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
        "suns": [_describe(name, lamp) for name, lamp in scene.lamps],
        "photograph": PHOTOGRAPH,
        "photograph_px": [width, height],
        "focal_length_px": scene.focal_px,
        "head": HEAD,
        "albedo": scene.albedo.tolist(),
        "ior": _index_of_refraction(scene.specular.f0),
        "roughness": scene.specular.roughness,
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
