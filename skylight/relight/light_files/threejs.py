"""three.js: a ``LightProbe`` for its ObjectLoader, and the map for reflections."""

import json
from pathlib import Path
from uuid import NAMESPACE_URL, uuid5

from skylight.io.files import write_environment_map, write_json
from skylight.relight.light_files.harmonics import rounded, second_degree
from skylight.sphere.envmap import EnvironmentMap

LIGHT_PROBE, TEXTURE = "lightprobe.json", "threejs_light.hdr"
_OBJECT_FORMAT = 4.7  # of three.js r187's Object3D.toJSON; its loader reads older ones too


def write_threejs(folder: Path, environment: EnvironmentMap) -> list[str]:
    """lightprobe.json: ``new ObjectLoader().parse(json)`` is a LightProbe with this light.

    Its 27 numbers are those of radiance, not irradiance (the renderer convolves them), in our
    basis and our axes, which are three.js' own: right-handed, +Y up. threejs_light.hdr is the map
    as its EquirectangularReflectionMapping looks it up, for ``scene.environment``: use either for
    diffuse light, not both.
    """
    write_environment_map(folder / TEXTURE, environment, convention="threejs")
    numbers = rounded(second_degree(environment), "threejs")
    probe = {
        # made from the content: the same light, the same file
        "uuid": str(uuid5(NAMESPACE_URL, json.dumps(numbers))),
        "type": "LightProbe",
        "name": "skylight",
        "layers": 1,
        "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
        "up": [0, 1, 0],
        "color": 0xFFFFFF,
        "intensity": 1,
        "sh": numbers,
    }
    metadata = {"version": _OBJECT_FORMAT, "type": "Object", "generator": "skylight"}
    write_json(folder / LIGHT_PROBE, {"metadata": metadata, "object": probe})
    return [LIGHT_PROBE, TEXTURE]
