"""three.js: a ``LightProbe`` for its ObjectLoader, its lamps, and the map for reflections."""

import json
from collections.abc import Sequence
from pathlib import Path
from uuid import NAMESPACE_URL, uuid5

import torch

from skylight.imaging.colour import linear_to_srgb, srgb_to_linear
from skylight.inverse.result import Lamp
from skylight.io.files import write_environment_map
from skylight.io.json_files import write_json
from skylight.relight.lamp_lights import colour_and_strength
from skylight.relight.light_files.harmonics import rounded, second_degree
from skylight.sphere.envmap import EnvironmentMap, luminance

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
