"""Light as nine spherical harmonics: JSON for any program, for three.js, and for ARCore and ARKit.

three.js gets a ``LightProbe`` for its ObjectLoader, its lamps, and the map for reflections; ARCore
and ARKit a main light, ambient harmonics and a cube map.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from uuid import NAMESPACE_URL, uuid5

import torch
from jaxtyping import Float
from torch import Tensor

from skylight._names import HarmonicConvention
from skylight.imaging._colour import linear_to_srgb, srgb_to_linear
from skylight.inverse._result import Lamp
from skylight.io._bounded import write_json
from skylight.io._files import write_environment_map, write_light
from skylight.relight._lamps import colour_and_strength, split_main_light
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._harmonics import project, to_convention
from skylight.sphere._projections import FACES, cube_faces

HARMONICS = "sh27.json"
LIGHT_PROBE, REFLECTED = "lightprobe.json", "threejs_light.hdr"
AR_LIGHT = "ar_light.json"
_STANDS_FOR = {
    "skylight": "radiance, RGB by coefficient (0,0) (1,-1) (1,0) (1,1) (2,-2) ... (2,2)",
    "threejs": "radiance, RGB by coefficient (0,0) (1,-1) (1,0) (1,1) (2,-2) ... (2,2)",
    "arcore": "radiance, RGB by coefficient, a minus for odd m (Condon-Shortley)",
    "arkit": "radiance, nine of red, nine of green, nine of blue",
    "gltf": "irradiance, RGB by coefficient, a minus for negative m",
}
_OBJECT_FORMAT = 4.7  # of three.js r187's Object3D.toJSON; its loader reads older ones too
_DISTANCE = 10  # of a lamp, where it can be seen and grabbed: its light is parallel


def second_degree(environment: EnvironmentMap) -> Float[Tensor, "9 3"]:
    """Coefficients of radiance up to degree 2 in :mod:`skylight.sphere._harmonics`' basis."""
    return project(environment.flat.double(), environment.grid, 2)


def rounded(coefficients: Float[Tensor, "9 3"], convention: HarmonicConvention) -> list[float]:
    """As float32 has them, which is what their readers store."""
    return to_convention(coefficients, convention).to(torch.float32).tolist()


def write_harmonics(
    folder: Path,
    environment: EnvironmentMap,
    convention: HarmonicConvention,
    *,
    cd_per_m2: float | None = None,
) -> list[str]:
    """sh27.json: the numbers, what they stand for, and the luminance of a radiance of 1."""
    content = {
        "format": "skylight sh27 1",
        "convention": convention,
        "numbers_are": _STANDS_FOR[convention],
        "axes": "right-handed, +Y up, the camera looks along -Z",
        "cd_per_m2": cd_per_m2,
        "sh": rounded(second_degree(environment), convention),
    }
    write_json(folder / HARMONICS, content)
    return [HARMONICS]


def write_threejs(
    folder: Path,
    environment: EnvironmentMap,
    lamps: Sequence[Lamp] = (),
    *,
    cd_per_m2: float | None = None,
) -> list[str]:
    """lightprobe.json: ``new ObjectLoader().parse(json)`` is a LightProbe with this light.

    Its 27 numbers are those of radiance, not irradiance (the renderer convolves them), in our
    basis and our axes, which are three.js' own: right-handed, +Y up. threejs_light.hdr is the map
    as its EquirectangularReflectionMapping looks it up, for ``scene.environment``: use either for
    diffuse light, not both.

    With ``lamps`` beside the ``environment``, it is a Group of that probe and a DirectionalLight
    for each lamp. ``cd_per_m2``, the luminance of a radiance of 1, is in its ``userData``.
    """
    write_environment_map(folder / REFLECTED, environment, convention="threejs")
    numbers = rounded(second_degree(environment), "threejs")
    tree = _object("LightProbe", "skylight", numbers, color=0xFFFFFF, intensity=1, sh=numbers)
    if lamps:
        lights = [_directional(number, lamp) for number, lamp in enumerate(lamps, start=1)]
        tree = _object("Group", "skylight", lights, children=[tree, *lights])
    tree["userData"] = {"cd_per_m2": cd_per_m2}
    metadata = {"version": _OBJECT_FORMAT, "type": "Object", "generator": "skylight"}
    write_json(folder / LIGHT_PROBE, {"metadata": metadata, "object": tree})
    return [LIGHT_PROBE, REFLECTED]


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


def write_augmented_reality(
    folder: Path, environment: EnvironmentMap, size: int, *, cd_per_m2: float | None = None
) -> list[str]:
    """ar_light.json and cube_px.hdr to cube_nz.hdr, faces of ``size`` pixels.

    As Google's sample shader for ARCore's Environmental HDR states it (environmental_hdr.frag),

        E(harmonics) + E(main light) = E(cube map):

    the cube map shows the sun, the harmonics do not. The main light's direction points towards
    it; its intensity is the irradiance of a plane that faces it, so that a diffuse surface sends
    back albedo / pi * (intensity <n, s>+ + E_harmonics(n)). ``cd_per_m2`` is the luminance of a
    radiance of 1.
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
        "cd_per_m2": cd_per_m2,
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
    write_json(folder / AR_LIGHT, content)
    return [AR_LIGHT, *files.values()]
