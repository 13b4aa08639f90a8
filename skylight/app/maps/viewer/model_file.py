"""A model of the user's own for the page, checked before it goes in."""

import struct
from pathlib import Path
from typing import Any

from skylight.errors import InputError
from skylight.io.bounded import file_bytes, json_loads
from skylight.transport.mesh import read_mesh

SUFFIXES = (".glb", ".obj")
TRIANGLES_MAX = 500_000  # of all copies that its scene places
_JSON_CHUNK = 0x4E4F534A
# Their decoders are not in the page.
_PACKED = {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu"}


def read_model(path: Path, *, most: int) -> bytes:
    """The content of a .glb or .obj file of at most ``most`` bytes that the page can show.

    Raises
    ------
    InputError
        Another format, a file that is missing, damaged, too large, not as long as it says, or not
        whole: one that names other files, which a page by itself cannot fetch.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: '{suffix}' is no model that the page reads: use .glb or .obj")
    try:
        content = file_bytes(path, most=most)
        if suffix == ".glb":
            _require_whole(content)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give another file") from error
    # readers of other people's scenes stumble over whatever is in there
    except (ValueError, struct.error, TypeError, AttributeError, KeyError, RecursionError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: the page cannot hold it ({reason})") from error
    triangles = len(read_mesh(path)[1])
    if triangles > TRIANGLES_MAX:
        raise InputError(
            f"{path}: {triangles} triangles are more than the {TRIANGLES_MAX} that the page draws: "
            "simplify it"
        )
    return content


def _require_whole(content: bytes) -> None:
    """ValueError, or whatever is raised by what is no scene, unless a .glb is all in itself."""
    magic, version, length = struct.unpack_from("<4sII", content)
    if magic != b"glTF" or version != 2:
        raise ValueError("it is no binary glTF 2.0")
    if length != len(content):
        raise ValueError(f"its header tells of {length} bytes, it has {len(content)}")
    chunks, at = [], 12
    while at < length:
        size, kind = struct.unpack_from("<II", content, at)
        if at + 8 + size > length:
            raise ValueError(f"a part of it tells of {size} bytes, {length - at - 8} are left")
        chunks.append((kind, content[at + 8 : at + 8 + size]))
        at += 8 + size
    if not chunks or chunks[0][0] != _JSON_CHUNK:
        raise ValueError("it has no scene")
    scene: Any = json_loads(chunks[0][1].decode("utf-8"))
    named = [entry.get("uri") for kind in ("buffers", "images") for entry in scene.get(kind, [])]
    if any(uri is not None and not uri.startswith("data:") for uri in named):
        raise ValueError("it names other files: pack buffers and textures into it")
    used = {*scene.get("extensionsUsed", []), *scene.get("extensionsRequired", [])} & _PACKED
    if used:
        raise ValueError(f"it is packed by {min(used)}: export it without compression")
