"""Binary glTF: a scene's JSON and its bytes, packed with the right lengths, or as it is.

Read for the page of an estimate, as a mesh and as a scene to relight.
"""

import struct
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from skylight.maps._viewer import read_model
from skylight.probes.partitions.relight._scene import read_scene
from skylight.transport._mesh import read_mesh
from tests.fuzz.files import as_file, joined, parted, read_by_any

_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_MOST = 2**20


def seeds() -> list[bytes]:
    box = trimesh.creation.box()
    codes = np.random.default_rng(0).integers(0, 256, (8, 8, 3), dtype=np.uint8)
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(codes), roughnessFactor=0.5
    )
    textured = trimesh.Trimesh(
        box.vertices, box.faces,
        visual=trimesh.visual.TextureVisuals(uv=box.vertices[:, :2] + 0.5, material=material),
        process=False,
    )  # fmt: skip
    scene = trimesh.Scene()
    for place in range(2):
        scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([place] * 3))
    whole = [each.export(file_type="glb") for each in (box, textured, scene)]
    return [whole[0], *(_unpacked(each) for each in whole)]


def read(content: bytes) -> None:
    path = as_file(content if content[:4] == b"glTF" else _packed(content), "model.glb")
    readers = (
        lambda: read_model(path, most=_MOST),
        lambda: _mesh(path),
        lambda: read_scene(path),
    )
    read_by_any(readers)


def _mesh(path: Path) -> None:
    vertices, faces = read_mesh(path)
    assert bool(vertices.isfinite().all())
    assert 0 <= int(faces.min()) <= int(faces.max()) < len(vertices)


def _unpacked(content: bytes) -> bytes:
    (size,) = struct.unpack_from("<I", content, 12)
    return joined({"scene": content[20 : 20 + size], "bytes": content[28 + size :]})


def _packed(content: bytes) -> bytes:
    members = parted(content)
    body = b""
    for name, kind, filler in (("scene", _JSON, b" "), ("bytes", _BINARY, b"\0")):
        if name in members:
            data = members[name] + filler * (-len(members[name]) % 4)
            body += struct.pack("<II", len(data), kind) + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body
