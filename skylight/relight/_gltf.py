"""glTF 2.0 with EXT_lights_image_based: prefiltered cube faces and harmonics of irradiance.

Lamps are directional lights of KHR_lights_punctual.

three.js: a ``LightProbe`` for its ObjectLoader, its lamps, and the map for reflections.
"""

import json
import struct
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from uuid import NAMESPACE_URL, uuid5

import numpy as np
import torch
from jaxtyping import UInt8
from PIL import Image

from skylight.imaging._colour import linear_to_srgb, srgb_to_linear
from skylight.inverse._result import Lamp
from skylight.io._atomic import atomic_path
from skylight.io._bounded import write_json
from skylight.io._files import write_environment_map
from skylight.io._hdr import LARGEST, encode_rgbd
from skylight.relight._lamps import colour_and_strength, prefiltered_levels, quaternion_towards
from skylight.relight._mitsuba import rounded, second_degree
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._projections import FACES
from skylight.sphere._wavelets import texel_solid_angles

LIGHT = "light.glb"
_JSON, _BINARY = 0x4E4F534A, 0x004E4942  # names of a .glb file's chunks


def write_gltf(
    folder: Path, environment: EnvironmentMap, size: int, lamps: Sequence[Lamp] = ()
) -> tuple[list[str], float]:
    """light.glb: a scene without objects whose light this is; ``size`` is a power of two.

    And the share of the light that the cube map lacks, cut off at 255 where RGBD ends: reflections
    of the sun are that much too dark, diffuse light is whole. The extension's ``intensity`` could
    scale it in, but Babylon.js multiplies diffuse light by that twice, so it stays 1.

    Levels are those of :func:`skylight.relight._lamps.prefiltered_levels`, as RGBD PNGs.

    The extension's text asks for OpenGL's faces, "each flipped about its vertical axis". It was
    written for Babylon.js, where glTF's (x, y, z) is (-x, y, z): the faces here are OpenGL's of
    the light mirrored in x, each flipped so, with +X and -X exchanged.

    ``lamps`` beside the ``environment`` are nodes that shine along their -Z. Their intensity is
    the irradiance of a surface that faces them: lux, were the map's radiance in cd / m^2.
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
    _write_glb(folder / LIGHT, light, pictures, names, lamps)
    return [LIGHT], float((whole - held) / max(whole, 1e-30))


def _png(codes: UInt8[np.ndarray, "h w 4"]) -> bytes:
    buffer = BytesIO()
    Image.fromarray(codes, "RGBA").save(buffer, format="PNG")
    return buffer.getvalue()


def _write_glb(
    path: Path, light: dict, pictures: list[bytes], names: list[str], lamps: Sequence[Lamp]
) -> None:
    """GLB container, glTF 2.0 specification, 4.4: every chunk fills up to four bytes."""
    views, binary = [], b""
    for picture in pictures:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(picture)})
        binary += picture + b"\0" * (-len(picture) % 4)
    extension = "EXT_lights_image_based"
    tree = {
        "asset": {"version": "2.0", "generator": "skylight"},
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


LIGHT_PROBE, TEXTURE = "lightprobe.json", "threejs_light.hdr"
_OBJECT_FORMAT = 4.7  # of three.js r187's Object3D.toJSON; its loader reads older ones too
_DISTANCE = 10  # of a lamp, where it can be seen and grabbed: its light is parallel


def write_threejs(
    folder: Path, environment: EnvironmentMap, lamps: Sequence[Lamp] = ()
) -> list[str]:
    """lightprobe.json: ``new ObjectLoader().parse(json)`` is a LightProbe with this light.

    Its 27 numbers are those of radiance, not irradiance (the renderer convolves them), in our
    basis and our axes, which are three.js' own: right-handed, +Y up. threejs_light.hdr is the map
    as its EquirectangularReflectionMapping looks it up, for ``scene.environment``: use either for
    diffuse light, not both.

    With ``lamps`` beside the ``environment``, it is a Group of that probe and a DirectionalLight
    for each lamp.
    """
    write_environment_map(folder / TEXTURE, environment, convention="threejs")
    numbers = rounded(second_degree(environment), "threejs")
    tree = _object("LightProbe", "skylight", numbers, color=0xFFFFFF, intensity=1, sh=numbers)
    if lamps:
        lights = [_directional(number, lamp) for number, lamp in enumerate(lamps, start=1)]
        tree = _object("Group", "skylight", lights, children=[tree, *lights])
    metadata = {"version": _OBJECT_FORMAT, "type": "Object", "generator": "skylight"}
    write_json(folder / LIGHT_PROBE, {"metadata": metadata, "object": tree})
    return [LIGHT_PROBE, TEXTURE]


def _directional(number: int, lamp: Lamp) -> dict[str, object]:
    """A lamp that shines on the origin: irradiance is intensity times linear colour.

    So it is since three.js r155. Its files have colours of eight bits in sRGB: luminance is exact,
    each channel to half a code.
    """
    colour, _ = colour_and_strength(lamp.irradiance)
    codes = (255 * linear_to_srgb(torch.tensor(colour))).round()
    red, green, blue = codes.int().tolist()
    intensity = luminance(lamp.irradiance.float()) / luminance(srgb_to_linear(codes / 255))
    x, y, z = (_DISTANCE * lamp.direction).tolist()
    return _object(
        "DirectionalLight",
        f"lamp {number}",
        [number, codes.tolist(), float(intensity), x, y, z],
        matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1],
        color=red << 16 | green << 8 | blue,
        intensity=float(intensity),
    )


def _object(kind: str, name: str, content: list, **more: object) -> dict[str, object]:
    return {
        # made from the content: the same light, the same file
        "uuid": str(uuid5(NAMESPACE_URL, json.dumps(content))),
        "type": kind,
        "name": name,
        "layers": 1,
        "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
        "up": [0, 1, 0],
        **more,
    }
