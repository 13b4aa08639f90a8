# SPDX-License-Identifier: GPL-3.0-or-later
"""The files that ``skylight export blender`` writes, read strictly."""

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .run import Failure

NAME, KIND, VERSION = "blender_scene.json", "skylight blender scene", 2
LARGEST = 3e38  # of Blender's numbers, which have single precision
MOST_PIXELS = 65536  # of a side that it renders
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Sun:
    """``towards`` it in Blender's axes; ``energy`` times ``colour`` is its irradiance."""

    name: str
    towards: Vector
    colour: Vector
    energy: float
    angle_rad: float


@dataclass(frozen=True)
class PortraitScene:
    """The camera is at the origin and looks along +Y, +Z up; its centre is the picture's middle.

    ``albedo``, ``ior`` and ``roughness`` are the skin's, as of a Principled BSDF; ``white`` is what
    white paint that faces the camera shows in this light, linear. ``estimate`` is the folder of the
    estimate, where the scene lies in one.
    """

    world: Path
    suns: tuple[Sun, ...]
    photograph: Path
    photograph_px: tuple[int, int]
    focal_length_px: float
    head: Path
    albedo: Vector
    ior: float
    roughness: float
    white: Vector
    verdict: str
    advice: tuple[str, ...]
    estimate: Path | None


def read_scene(folder: Path) -> PortraitScene:
    """Raises :class:`Failure` where a file is missing, damaged or of another version."""
    path = folder / NAME
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        json.dumps(content, ensure_ascii=False).encode()  # Blender's texts take no lone surrogates
    except OSError as error:
        raise Failure(f"{path}: cannot be read ({error.strerror}): estimate again") from error
    except (ValueError, RecursionError) as error:
        raise Failure(f"{path}: no JSON: estimate again") from error
    if not isinstance(content, dict) or content.get("kind") != KIND:
        raise Failure(f"{path}: not a scene that skylight wrote for Blender")
    if content.get("version") != VERSION:
        raise Failure(
            f"{path}: version {content.get('version')!r}, this extension reads {VERSION}: "
            "update the older one of extension and skylight"
        )
    try:
        width, height = content["photograph_px"]
        scene = PortraitScene(
            world=folder / _file_name(content["world"]),
            suns=tuple(_sun(told) for told in content["suns"]),
            photograph=folder / _file_name(content["photograph"]),
            photograph_px=(_whole(width), _whole(height)),
            focal_length_px=_number(content["focal_length_px"], above=0),
            head=folder / _file_name(content["head"]),
            albedo=_vector(content["albedo"]),
            ior=_number(content["ior"], least=1),
            roughness=_number(content["roughness"], least=0),
            white=_vector(content["white"], least=0),
            verdict=str(content["verdict"]),
            advice=tuple(str(line) for line in content["advice"]),
            estimate=folder.parent if (folder.parent / "estimate.json").is_file() else None,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise Failure(f"{path}: damaged ({error}): estimate again") from error
    for file in (scene.world, scene.photograph, scene.head):
        if not os.path.isfile(file):  # Path's raises for names that are too long
            raise Failure(f"{file}: there is no such file: estimate again")
    return scene


def read_head(path: Path) -> tuple[list[Vector], list[tuple[int, ...]]]:
    """Vertices in Blender's axes, and the faces, of the .obj that skylight writes.

    An .obj has +Y up and looks along -Z, so its (x, y, z) is (x, -z, y) here.
    """
    vertices: list[Vector] = []
    faces: list[tuple[int, ...]] = []
    try:
        for line in path.read_text(encoding="utf-8").splitlines():
            kind, _, rest = line.partition(" ")
            if kind == "v":
                x, y, z = (_number(float(part)) for part in rest.split())
                vertices.append((x, -z, y))
            elif kind == "f":
                faces.append(tuple(int(part) - 1 for part in rest.split()))
    except (OSError, ValueError, TypeError) as error:
        raise Failure(f"{path}: cannot be read ({error}): estimate again") from error
    largest = len(vertices)
    if not faces or not all(len(f) > 2 and 0 <= min(f) <= max(f) < largest for f in faces):
        raise Failure(f"{path}: no whole mesh: estimate again")
    return vertices, faces


def _sun(told: dict[str, Any]) -> Sun:
    return Sun(
        name=str(told["name"]),
        towards=_vector(told["towards"]),
        colour=_vector(told["colour"]),
        energy=_number(told["energy"], least=0),
        angle_rad=_number(told["angle_rad"], least=0),
    )


def _file_name(told: Any) -> str:
    """That of a file beside the scene's, which no name can lead away from."""
    if not isinstance(told, str) or not told.isprintable() or told != Path(told).name:
        raise ValueError(f"a file's name was expected, not {told!r}")
    return told


def _vector(told: Any, *, least: float = -math.inf) -> Vector:
    x, y, z = (_number(each, least=least) for each in told)
    return x, y, z


def _number(told: Any, *, above: float = -math.inf, least: float = -math.inf) -> float:
    if isinstance(told, bool) or not isinstance(told, int | float) or not abs(told) <= LARGEST:
        raise ValueError(f"a number was expected, not {told!r}")
    if not above < told or told < least:
        raise ValueError(f"{told!r} is too small")
    return float(told)


def _whole(told: Any) -> int:
    if isinstance(told, bool) or not isinstance(told, int) or not 1 <= told <= MOST_PIXELS:
        raise ValueError(f"a number of pixels was expected, not {told!r}")
    return told
