"""Meshes: .obj, .ply, .stl, .off and .glb, told apart by how they begin."""

import trimesh

from skylight.probes.partitions.relight._scene import read_scene
from skylight.transport._mesh import read_mesh
from tests.fuzz.files import as_file, written

_BEGINNINGS = {b"glTF": ".glb", b"ply": ".ply", b"OFF": ".off", b"solid": ".stl", b"\0stl": ".stl"}


def seeds() -> list[bytes]:
    box = trimesh.creation.box()
    coloured = trimesh.Trimesh(box.vertices, box.faces, vertex_colors=[200, 100, 50, 255])
    obj = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nvt 0 0\nf 1/1/1 2/1/1 -1/1/1\n"
    return [
        obj,
        *(
            written(f"a{suffix}", lambda path: coloured.export(path))
            for suffix in (".obj", ".ply", ".off", ".glb")
        ),
        written(
            "b.ply", lambda path: path.write_bytes(box.export(file_type="ply", encoding="ascii"))
        ),
        b"\0stl" + box.export(file_type="stl"),
        box.export(file_type="stl_ascii").encode(),
    ]


def read(content: bytes) -> None:
    begins = next((begin for begin in _BEGINNINGS if content.startswith(begin)), b"")
    suffix = _BEGINNINGS.get(begins, ".obj")
    path = as_file(content.removeprefix(b"\0stl"), f"mesh{suffix}")
    vertices, faces = read_mesh(path)
    assert bool(vertices.isfinite().all())
    assert int(faces.min()) >= 0
    assert int(faces.max()) < len(vertices)
    read_scene(path)
