"""ARCore and ARKit: a main light, ambient harmonics and a cube map."""

from pathlib import Path

from skylight.io.files import write_light
from skylight.io.json_files import write_json
from skylight.relight.light_files.harmonics import rounded, second_degree
from skylight.relight.main_light import split_main_light
from skylight.sphere.cube_faces import FACES, cube_faces
from skylight.sphere.envmap import EnvironmentMap

DESCRIPTION = "ar_light.json"


def write_augmented_reality(folder: Path, environment: EnvironmentMap, size: int) -> list[str]:
    """ar_light.json and cube_px.hdr to cube_nz.hdr, faces of ``size`` pixels.

    As Google's sample shader for ARCore's Environmental HDR states it (environmental_hdr.frag),

        E(harmonics) + E(main light) = E(cube map):

    the cube map shows the sun, the harmonics do not. The main light's direction points towards
    it; its intensity is the irradiance of a plane that faces it, so that a matt surface sends
    back albedo / pi * (intensity <n, s>+ + E_harmonics(n)).
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
    write_json(folder / DESCRIPTION, content)
    return [DESCRIPTION, *files.values()]
