"""Sizes of mesh files, checked before memory is allocated."""

import re
import struct
from io import BytesIO
from itertools import takewhile
from pathlib import Path
from typing import Any

from skylight.io.bounded import (
    ARRAY_BYTES_MAX,
    TEXT_BYTES_MAX,
    file_bytes,
    json_content,
    json_loads,
    require_bytes,
)

FACES_MAX = 50_000_000
_GLB_SHARED = 16  # so often may accessors share a file's bytes
_JSON_CHUNK = 0x4E4F534A
_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}  # glTF 2.0, 3.6.2.2
_NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# vertices count from 1, from -1 backwards; readers take 0 for the last
_NO_VERTEX = re.compile(rb"^[ \t]*f(?=[ \t])[^\n#]*[ \t]0+(?:[/\s]|\Z)", re.M)


def require_bounded(path: Path) -> None:
    """Refuse files that are too large, or make much of little.

    Raises
    ------
    OSError, ValueError
        As :func:`skylight.io.bounded.file_bytes`; a glTF scene whose accessors or instances
        take far more memory than the file, an .obj face of vertex 0, or a text with fewer rows
        than its header says, which the readers take as it is.
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
