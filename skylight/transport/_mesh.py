"""Mesh files, read for shading, their size checked before memory is allocated."""

import logging
import math
import re
import struct
from collections.abc import Callable
from io import BytesIO
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.errors import InputError
from skylight.io._bounded import (
    ARRAY_BYTES_MAX,
    TEXT_BYTES_MAX,
    file_bytes,
    json_content,
    json_loads,
    require_bytes,
)

if TYPE_CHECKING:
    from trimesh import Trimesh


FACES_MAX = 50_000_000
_GLB_SHARED = 16  # so often may accessors share a file's bytes
_JSON_CHUNK = 0x4E4F534A
_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}  # glTF 2.0, 3.6.2.2
_NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# vertices count from 1, from -1 backwards; readers take 0 for the last
_NO_VERTEX = re.compile(rb"^[ \t]*f(?=[ \t])[^\n#]*[ \t]0+(?:[/\s]|\Z)", re.M)


def require_bounded(path: Path) -> None:
    """Refuse files that are too large, or make much of little, which the readers take as they are.

    OSError or ValueError: a glTF scene whose accessors or instances take far more memory than the
    file, an .obj face of vertex 0, or a text with fewer rows than its header says.
    """
    size = require_bytes(path)
    suffix = path.suffix.lower()
    if suffix == ".obj" and _NO_VERTEX.search(file_bytes(path)):
        raise ValueError("a face names vertex 0, they count from 1")
    if suffix in (".ply", ".off"):
        _require_rows(file_bytes(path))
    if suffix == ".glb":
        _require_scene(_glb_header(path, size), most=2**24 + _GLB_SHARED * size)
    if suffix == ".gltf":
        _require_scene(json_content(path), most=ARRAY_BYTES_MAX)


def _require_rows(content: bytes) -> None:
    """For .off and .ply in text; a row that is cut within its last number cannot be told."""
    is_off, is_ply = content.startswith(b"OFF"), content.startswith(b"ply")
    if not is_off and not (is_ply and b"\nformat ascii" in content[:99]):
        return
    rows = (row for line in BytesIO(content) if (row := line.partition(b"#")[0].split()))
    if is_off:
        counts = next(rows)[1:] or next(rows, [])  # they may stand beside the name
        wanted = sum(int(word) for word in counts[:2])
    else:
        head = takewhile(lambda row: row != [b"end_header"], rows)
        wanted = sum(int(row[2]) for row in head if row[0] == b"element")
    if (found := sum(1 for _ in rows)) < wanted:
        raise ValueError(f"cut short: {found} rows of {wanted}")


def _glb_header(path: Path, size: int) -> Any:
    with path.open("rb") as stream:
        magic, _, _, length, kind = struct.unpack("<4sIIII", stream.read(20))
        if magic != b"glTF" or kind != _JSON_CHUNK or length > size:
            raise ValueError("it does not begin like one, or is cut short")
        if length > TEXT_BYTES_MAX:
            raise ValueError(f"a scene of {length} bytes, more than the {TEXT_BYTES_MAX} read")
        return json_loads(stream.read(length).decode("utf-8"))


def _require_scene(scene: Any, most: int) -> None:
    """Raises whatever a scene that is none makes of it, beside ValueError."""
    accessors = scene.get("accessors", [])
    counts = [int(accessor["count"]) for accessor in accessors]
    if any(count < 0 for count in counts):
        raise ValueError("an accessor of less than nothing")
    together = sum(
        count * _BYTES[accessor["componentType"]] * _NUMBERS[accessor["type"]]
        for count, accessor in zip(counts, accessors, strict=True)
    )
    if together > most:
        raise ValueError(f"its accessors take {together} bytes, more than the file can hold")
    corners = [
        sum(
            counts[part["indices"] if "indices" in part else part["attributes"]["POSITION"]]
            for part in mesh["primitives"]
        )
        for mesh in scene.get("meshes", [])
    ]
    drawn = sum(corners[node["mesh"]] for node in scene.get("nodes", []) if "mesh" in node)
    if drawn > 3 * FACES_MAX:
        raise ValueError(f"it draws {drawn // 3} faces, more than the {FACES_MAX} that are read")


# its tracebacks of damaged files would go to standard error, and the exception says it
logging.getLogger("trimesh").addHandler(logging.NullHandler())

MESH_SUFFIXES = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
FARTHEST = 1e15  # rays are float32
CREASE_RAD = math.radians(40.0)  # edges sharper than this stay edges in shading


def read_mesh(path: str | Path) -> tuple[Float[Tensor, "n 3"], Int[Tensor, "f 3"]]:
    """Vertices and faces of a mesh file, in its own units and axes, as :func:`creased` has them.

    Raises
    ------
    InputError
        A missing or damaged file, another format, no faces, or vertices that are not finite.
    """
    path = Path(path)
    mesh = loaded_mesh(path, _merged)
    try:
        return creased(mesh)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _merged(path: Path) -> "Trimesh":
    """All meshes of a file as one, vertices at the same place made one within each."""
    import trimesh  # slow to import

    meshes: Any = trimesh.load_scene(path, process=False).dump()
    parts = [mesh for mesh in meshes if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    for mesh in parts:
        # the merging would take an index below 0 for one from the end
        if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
            raise ValueError(f"its faces must index its {len(mesh.vertices)} vertices")
        mesh.process()
    whole: Any = trimesh.util.concatenate(parts) if parts else trimesh.Trimesh()
    return whole


def loaded_mesh(path: Path, load: Callable[[Path], Any]) -> Any:
    """What one of trimesh's readers makes of a mesh file."""
    if not path.is_file():
        raise InputError(f"{path}: there is no such mesh")
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(
            f"{path}: '{path.suffix}' is no mesh known here: use {', '.join(MESH_SUFFIXES)}"
        )
    try:
        require_bounded(path)
        return load(path)
    # the readers raise whatever their parsing stumbles over
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: damaged, or no {path.suffix} mesh ({reason})") from error


def require_coordinates(vertices: Float[np.ndarray, "n k"]) -> None:
    """Raise :class:`InputError` for vertices that are not finite, or whose squares may not be.

    Also where there are not three to each, which the readers let pass.
    """
    if vertices.shape[1] != 3:
        raise InputError(f"the mesh has vertices of {vertices.shape[1]} coordinates; repair it")
    if not (np.abs(vertices) < FARTHEST).all():  # false for NaN too
        raise InputError(
            f"the mesh has vertices that are NaN, infinite or beyond {FARTHEST:g}; repair it"
        )


def creased(mesh: "Trimesh") -> tuple[Float[Tensor, "n 3"], Int[Tensor, "f 3"]]:
    """Vertices and faces, vertices split where faces meet at more than 40 degrees.

    Normals that are averaged at the vertices are then smooth on smooth parts and break at edges.
    """
    from trimesh.graph import smooth_shade

    if not len(mesh.faces):
        raise InputError("the mesh has no faces: points and curves show no shading")
    require_coordinates(mesh.vertices)
    smooth = smooth_shade(mesh, angle=CREASE_RAD)
    vertices = torch.from_numpy(np.array(smooth.vertices, np.float64))
    return vertices, torch.from_numpy(np.array(smooth.faces, np.int64))
