"""glTF 2.0 with EXT_lights_image_based: prefiltered cube faces and harmonics of irradiance.

Lamps are directional lights of KHR_lights_punctual.
"""

import json
import struct
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from PIL import Image
from torch import Tensor

from skylight.inverse._result import Lamp
from skylight.io._atomic import atomic_path
from skylight.io._hdr import LARGEST, encode_rgbd
from skylight.relight._harmonics import rounded, second_degree
from skylight.relight._lamps import colour_and_strength, quaternion_towards
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._projections import FACES, cube_faces, face_directions
from skylight.sphere._wavelets import texel_solid_angles
from skylight.transport._render import reflection_weights

LIGHT = "light.glb"
_JSON, _BINARY = 0x4E4F534A, 0x004E4942  # names of a .glb file's chunks
LAST_SIZE = 16  # pixels of the roughest level
BLURRED_ROWS = 64  # of the map that rough levels are made from: cells of 2.8 degrees
_BLOCK = 1024  # directions at a time: 64 MB of scratch


def write_gltf(
    folder: Path,
    environment: EnvironmentMap,
    size: int,
    lamps: Sequence[Lamp] = (),
    *,
    cd_per_m2: float | None = None,
) -> tuple[list[str], float]:
    """light.glb: a scene without objects whose light this is; ``size`` is a power of two.

    And the share of the light that the cube map lacks, cut off at 255 where RGBD ends: reflections
    of the sun are that much too dark, diffuse light is whole. The extension's ``intensity`` could
    scale it in, but Babylon.js multiplies diffuse light by that twice, so it stays 1.

    Levels are those of :func:`prefiltered_levels`, as RGBD PNGs.

    The extension's text asks for OpenGL's faces, "each flipped about its vertical axis". It was
    written for Babylon.js, where glTF's (x, y, z) is (-x, y, z): the faces here are OpenGL's of
    the light mirrored in x, each flipped so, with +X and -X exchanged.

    ``lamps`` beside the ``environment`` are nodes that shine along their -Z. Their intensity is
    the irradiance of a surface that faces them: lux, were the map's radiance in cd / m^2; the
    luminance of a radiance of 1, ``cd_per_m2``, is among the asset's ``extras``.
    """
    mirrored = EnvironmentMap(radiance=environment.radiance.flip(1))
    levels = [level.cpu().numpy() for level in prefiltered_levels(mirrored, size)]
    solid = texel_solid_angles(size)[..., None].numpy()
    whole, held = ((solid * faces).sum() for faces in (levels[0], levels[0].clip(max=LARGEST)))
    pictures: list[bytes] = []
    names, numbers = [], []
    for depth, level in enumerate(levels):
        numbers.append(list(range(len(pictures), len(pictures) + 6)))
        for name, face in zip(FACES, level, strict=True):
            pictures.append(_png(encode_rgbd(face.clip(max=LARGEST))))
            names.append(f"{name}_{depth}")
    harmonics = rounded(second_degree(environment), "gltf")
    light = {
        "name": "skylight",
        "intensity": 1.0,
        "irradianceCoefficients": [harmonics[3 * k : 3 * k + 3] for k in range(9)],
        "specularImageSize": size,
        "specularImages": numbers,
    }
    extras = {"cd_per_m2": cd_per_m2}
    _write_glb(folder / LIGHT, light, pictures, names, lamps, extras)
    return [LIGHT], float((whole - held) / max(whole, 1e-30))


def prefiltered_levels(environment: EnvironmentMap, size: int) -> list[Float[Tensor, "6 s s 3"]]:
    """Faces of ``size``, half of it, and so on down to 16 pixels a side.

    Level m of n stands for the perceptual roughness m / (n - 1) and alpha, its square. Level 0 is
    the map itself; the others are

        L'(r) = sum_w L(w) D(h) <r,w>+ dw / sum_w D(h) <r,w>+ dw,

    with D the GGX density (:func:`skylight.transport._render.reflection_weights`).
    """
    levels = [cube_faces(environment, size)]
    coarse = environment
    if environment.layout[0] > BLURRED_ROWS:
        coarse = environment.resize(BLURRED_ROWS)
    grid, light = coarse.grid, coarse.flat.float()
    sizes = []
    while size // 2 >= LAST_SIZE:
        size //= 2
        sizes.append(size)
    for number, smaller in enumerate(sizes, start=1):
        alpha = (number / len(sizes)) ** 2
        towards = face_directions(smaller).reshape(-1, 3)
        blurred = [reflection_weights(r, grid, alpha) @ light for r in towards.split(_BLOCK)]
        levels.append(torch.cat(blurred).reshape(6, smaller, smaller, 3).to(levels[0]))
    return levels


def _png(codes: UInt8[np.ndarray, "h w 4"]) -> bytes:
    buffer = BytesIO()
    Image.fromarray(codes, "RGBA").save(buffer, format="PNG")
    return buffer.getvalue()


def _write_glb(
    path: Path,
    light: dict,
    pictures: list[bytes],
    names: list[str],
    lamps: Sequence[Lamp],
    extras: dict,
) -> None:
    """GLB container, glTF 2.0 specification, 4.4: every chunk fills up to four bytes."""
    views, binary = [], b""
    for picture in pictures:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(picture)})
        binary += picture + b"\0" * (-len(picture) % 4)
    extension = "EXT_lights_image_based"
    tree = {
        "asset": {"version": "2.0", "generator": "skylight", "extras": extras},
        "extensionsUsed": [extension],
        "extensions": {extension: {"lights": [light]}},
        "scene": 0,
        "scenes": [{"extensions": {extension: {"light": 0}}}],
        "images": [
            {"name": name, "mimeType": "image/png", "bufferView": number}
            for number, name in enumerate(names)
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    if lamps:
        _add_lamps(tree, lamps)
    text = json.dumps(tree, separators=(",", ":"), allow_nan=False).encode("utf-8")
    text += b" " * (-len(text) % 4)
    chunks = [struct.pack("<II", len(text), _JSON), text]
    chunks += [struct.pack("<II", len(binary), _BINARY), binary]
    length = 12 + sum(len(chunk) for chunk in chunks)
    with atomic_path(path) as temporary:
        temporary.write_bytes(b"".join([b"glTF", struct.pack("<II", 2, length), *chunks]))


def _add_lamps(tree: dict, lamps: Sequence[Lamp]) -> None:
    extension = "KHR_lights_punctual"
    lights, nodes = [], []
    for number, lamp in enumerate(lamps):
        name = f"lamp {number + 1}"
        colour, strength = colour_and_strength(lamp.irradiance)
        lights.append({"name": name, "type": "directional", "color": colour, "intensity": strength})
        rotation = quaternion_towards(lamp.direction)
        nodes.append(
            {"name": name, "rotation": rotation, "extensions": {extension: {"light": number}}}
        )
    tree["extensionsUsed"].append(extension)
    tree["extensions"][extension] = {"lights": lights}
    tree["nodes"] = nodes
    tree["scenes"][0]["nodes"] = list(range(len(nodes)))
