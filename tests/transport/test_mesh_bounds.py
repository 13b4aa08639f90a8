import json
import struct
from pathlib import Path

import pytest

from skylight.errors import InputError
from skylight.probes.partitions.relight._scene import read_scene
from skylight.transport._mesh import read_mesh

CORNERS = "0 0 0\n1 0 0\n0 1 0\n"
PLY = (
    "ply\nformat ascii 1.0\ncomment three corners\nelement vertex 3\nproperty float x\n"
    "property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\n"
    "end_header\n"
)
LOOP = "facet\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n{}\nendloop\nendfacet\n"
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.off", f"OFF\n3 1 0\n{CORNERS}3 0 1 2\n"),
        ("a.off", f"OFF 3 1 0\n# corners\n\n{CORNERS}3 0 1 2 # the face\n"),
        ("a.ply", f"{PLY}{CORNERS}3 0 1 2\n"),
        ("a.ply", f"{PLY}{CORNERS}3 0 1 2\n".replace("\n", "\r\n")),
        ("a.obj", f"{OBJ}f 1 2 3 # face 0\n"),
        ("a.obj", f"vt 0 0\n{OBJ}f 1/0/0 -2 3\n"),
        ("a.obj", f"{OBJ}f 1 2 3\nfoo 0 0\n"),
    ],
)
def test_good_files_pass(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    path.write_bytes(text.encode())
    assert len(read_mesh(path)[1]) == 1


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a.off", f"OFF\n3 1 0\n{CORNERS}", "3 rows of 4"),
        ("a.off", "OFF", "not read as .off"),
        ("a.off", "OFF BINARY\n", "it is binary"),
        ("a.ply", f"{PLY}{CORNERS}", "3 rows of 4"),
        ("a.ply", PLY.replace("end_header\n", ""), "cut short"),
        ("a.ply", PLY.replace("face", "tristrips"), "strips, which are not read"),
        ("a.obj", f"{OBJ}f 1 2 0", "vertex 0"),
        ("a.obj", f"{OBJ}f 1 2 9\n", "9|8"),
        ("a.obj", f"{OBJ}f -1 -2 -4\n", "vertex -4, where 3"),
        ("a.obj", OBJ.removesuffix(" 0\n") + "\nf 1 2 -1\n", "coordinates"),
        ("a.obj", f"{OBJ}f 0/1/1 2/1/1 3/1/1\n", "vertex 0"),
        ("a.obj", f"{OBJ}cstype bezier\ndeg 1 1\nsurf 0 1 0 1 1 2 3 3\nend\n", "free-form"),
        ("a.obj", f"{OBJ}f 1 1 2\nf 2 2 2\n", "none of its 2 triangles has an area"),
        ("a.stl", f"solid a\n{LOOP.format('vertex 0 1 0')}", "no endsolid"),
        ("a.stl", f"solid a\n{LOOP.format('')}endsolid a\n", "no triangle"),
        ("a.stl", "solid a\nfacet\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n", "cut short"),
    ],
)
def test_what_the_readers_would_take_as_it_is(
    tmp_path: Path, name: str, text: str, reason: str
) -> None:
    path = tmp_path / name
    path.write_text(text)
    for read in (read_mesh, read_scene):
        with pytest.raises(InputError, match=reason):
            read(path)


def test_a_glb_of_nothing_but_scene(tmp_path: Path) -> None:
    """Its JSON is bounded as any other; the sparse file takes no disk."""
    length = 2**26 + 4
    path = tmp_path / "a.glb"
    with path.open("wb") as stream:
        stream.write(struct.pack("<4sIIII", b"glTF", 2, 20 + length, length, 0x4E4F534A))
        stream.write(json.dumps({"asset": {"version": "2.0"}}).encode())
        stream.truncate(20 + length)
    with pytest.raises(InputError, match="more than the"):
        read_mesh(path)
