"""Models that lie: each is refused in one line before a reader believes it."""

import json
import struct
from typing import Any

from tests.studio.composite.composite_modules import called

MOST_VERTICES = 1000


def refusals(*files: bytes) -> list[str | None]:
    return called("glb_check", *(("checkGlb", file, MOST_VERTICES) for file in files))


def glb(claims: object, data: bytes = bytes(36), **header: int) -> bytes:
    """A file of three vertices, with what it claims."""
    text = claims if isinstance(claims, bytes) else json.dumps(claims).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", header.get("json", len(text)), 0x4E4F534A) + text
    chunks += struct.pack("<II", header.get("binary", len(data)), 0x004E4942) + data
    length = header.get("length", 12 + len(chunks))
    return struct.pack("<III", 0x46546C67, header.get("version", 2), length) + chunks


def claims(**changed: Any) -> dict[str, Any]:
    """Those of a triangle."""
    return {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        **changed,
    }


def test_a_triangle_is_taken() -> None:
    strided = claims(
        bufferViews=[{"buffer": 0, "byteLength": 36, "byteStride": 12}],
        images=[{"uri": "data:image/png;base64,AA=="}],
    )
    zeros = claims(
        accessors=[
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"componentType": 5126, "count": 3, "type": "VEC3", "sparse": {"count": 1}},
        ]
    )
    assert refusals(glb(claims()), glb(strided), glb(zeros)) == [None] * 3


def accessor(**changed: Any) -> dict[str, Any]:
    one = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", **changed}
    return claims(accessors=[{name: value for name, value in one.items() if value is not None}])


LIES: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "no .glb"),
    "text": (b"solid of triangles, but in another format", "no .glb"),
    "old": (glb(claims(), version=1), "glTF 1"),
    "a gigabyte": (glb(claims(), length=2**30), "says that it has 1073741824 bytes"),
    "cut off": (glb(claims())[:-8], "says that it has"),
    "long header": (glb(claims(), json=2**31), "header reaches beyond"),
    "no JSON": (glb(b"{" * 40), "no JSON"),
    "a number": (glb(b"42"), "no JSON object"),
    "long data": (glb(claims(), binary=2**31), "data reach beyond"),
    "buffer": (glb(claims(buffers=[{"byteLength": 10**9}])), "claims 1000000000 bytes"),
    "half a byte": (glb(claims(buffers=[{"byteLength": 35.5}])), "no number"),
    "view": (
        glb(claims(bufferViews=[{"buffer": 0, "byteOffset": 8, "byteLength": 36}])),
        "a part of its data",
    ),
    "accessor": (glb(accessor(count=4)), "claims 4 values"),
    "offset": (glb(accessor(byteOffset=4)), "claims 3 values"),
    "many zeros": (glb(accessor(bufferView=None, count=10**9)), "claims 1000000000 values"),
    "no view": (glb(accessor(bufferView=7)), "claims 3 values"),
    "drawn often": (
        glb(claims(nodes=[{"mesh": 0}] * 500, scenes=[{"nodes": list(range(500))}])),
        "1500 vertices",
    ),
    "a ring of nodes": (
        glb(claims(nodes=[{"children": [1]}, {"children": [0], "mesh": 0}])),
        "not a tree",
    ),
    "elsewhere": (
        glb(claims(images=[{"uri": "https://example.org/texture.png"}])),
        "refers to other files",
    ),
    "packed": (
        glb(claims(extensionsRequired=["KHR_draco_mesh_compression"])),
        "without compression",
    ),
}


def test_each_lie_has_its_line() -> None:
    lines = refusals(*(file for file, _ in LIES.values()))
    for name, line, (_, want) in zip(LIES, lines, LIES.values(), strict=True):
        assert line is not None, name
        assert want in line
        assert "\n" not in line
        assert len(line) < 140


def test_no_part_of_a_file_is_taken() -> None:
    whole = glb(claims())
    assert all(refusals(*(whole[:length] for length in range(len(whole)))))
