"""One cube in the dialects of OBJ, PLY, STL and OFF that programs write."""

import struct
from pathlib import Path

import numpy as np
import pytest

from skylight.probes.partitions.relight._scene import read_scene
from skylight.transport._mesh import read_mesh
from skylight.transport._text_meshes import triangulated

CORNERS = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = [face for a, b, c, d in QUADS for face in ((a, b, c), (a, c, d))]
# of the same faces, some as they are and some cut
MIXED = [*QUADS[:5], *TRIANGLES[10:]]


def require_cube(path: Path) -> None:
    """Volume, area and corners: three facts that no other mesh of 12 triangles shares."""
    scene = read_scene(path)
    for vertices, faces in (read_mesh(path), (scene.vertices, scene.faces)):
        places = vertices[faces].double().numpy()
        a, b, c = places.transpose(1, 0, 2)
        assert np.linalg.det(places).sum() / 6 == pytest.approx(8)
        assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(24)
        assert {tuple(place) for place in places.reshape(-1, 3)} == set(CORNERS)


def rows(values: list, form: str = "{}") -> str:
    return "".join(form.format(" ".join(str(each) for each in row)) + "\n" for row in values)


def from_one(faces: list) -> list:
    return [tuple(corner + 1 for corner in face) for face in faces]


PLACES = rows(CORNERS, "v {}")
OBJ = PLACES + rows(from_one(QUADS), "f {}")


def relative(each_corner: str = "{0}") -> str:
    """Each face right behind its own corners, named from the last."""
    text = ""
    for quad in QUADS:
        text += rows([CORNERS[k] for k in quad], "v {}") + "vt 0 0\nvn 0 0 1\n"
        text += rows([[each_corner.format(k) for k in (-4, -3, -2, -1)]], "f {}")
    return text


@pytest.mark.parametrize(
    "text",
    [
        OBJ,
        OBJ.replace("\n", "\r\n"),
        OBJ.replace("\n", "\r"),
        "\ufeff" + OBJ,
        OBJ.replace(" ", "\t"),
        OBJ.replace("v ", "  v   ").replace("f ", "\t f\t"),
        "# v 9 9 9\n" + OBJ.replace("\n", " # 5 6\n"),
        "  # indented\no cube # 1\ns off\n" + OBJ,
        OBJ.replace("f 1 2", "f 1 2\\\n"),
        OBJ.replace("f 1 2 4", "f 1 2\\\r\n4"),
        OBJ.replace("f ", "fo "),
        rows(from_one(QUADS), "f {}") + PLACES,
        PLACES + rows(from_one(MIXED), "f {}"),
        PLACES.replace("\n", " 1.0\n") + rows(from_one(QUADS), "f {}"),
        PLACES.replace("\n", " 1 0.5 0\n") + rows(from_one(QUADS), "f {}"),
        PLACES + "vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 4/1/1 3/1/1\nf 5//1 7//1 8//1 6//1\n"
        "f 1/1 5/1 6/1 2/1\nf 3/ 4/ 8/ 7/\nf 1// 3// 7// 5//\nf 2 6 8 4\n",
        # as many numbers in each line, of other kinds
        PLACES + "vt 0 0\nf 1 2 4 4 3 1\nf 5/1 7/1 8/1\nf 5//1 8//1 6//1\n"
        + rows(from_one(QUADS[2:]), "f {}"),
        PLACES + "vt 0 0\nf 1/1/1 2 4\n" + rows(from_one(TRIANGLES[1:]), "f {}"),
        relative(),
        relative("{0}/-1/-1"),
        relative("{0}//-1"),
        "# C:\\models\\\n" + OBJ,
        OBJ.replace("\n", " # C:\\\n", 8),
        OBJ.replace("\n", " \n"),
    ],
)  # fmt: skip
def test_wavefront(tmp_path: Path, text: str) -> None:
    (tmp_path / "cube.obj").write_bytes(text.encode())
    require_cube(tmp_path / "cube.obj")


def test_wavefront_in_two_bytes_a_character(tmp_path: Path) -> None:
    (tmp_path / "cube.obj").write_bytes(OBJ.encode("utf-16"))
    require_cube(tmp_path / "cube.obj")


@pytest.mark.parametrize(
    ("corners", "area"),
    [
        ([(0, 0), (2, 1), (4, 0), (2, 4)], 6),
        ([(0, 0), (4, 0), (4, 4), (2, 1), (0, 4)], 10),
        ([(0, 4), (2, 1), (4, 4), (4, 0), (0, 0)], 10),
        ([(0, 0), (3, 0), (3, 1), (1, 1), (1, 2), (3, 2), (3, 3), (0, 3)], 7),
        ([(0, 0), (2, 0), (4, 0), (4, 4), (0, 4)], 16),
        ([(0, 0), (2, 0), (4, 0), (4, 4), (2, 1), (0, 4), (0, 2)], 10),
        # a hole on a bridge, as programs write faces with holes
        ([(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)], 12),
    ],
)
@pytest.mark.parametrize("kind", ["obj", "ply", "off"])
def test_a_polygon_keeps_its_area(tmp_path: Path, corners: list, area: float, kind: str) -> None:
    """By the shoelace formula; a fan about the first corner covers what is outside of it."""
    path, count = tmp_path / f"polygon.{kind}", len(corners)
    heads = {
        "ply": f"ply\nformat ascii 1.0\nelement vertex {count}\n{FLOATS}element face 1\n{LIST}"
        "end_header\n",
        "off": f"OFF\n{count} 1 0\n",
    }
    for axes in ([0, 1, 2], [2, 0, 1], [1, 2, 0]):
        places = np.array([(*corner, 0) for corner in corners])[:, axes]
        if kind == "obj":
            text = rows(places.tolist(), "v {}") + rows(from_one([range(count)]), "f {}")
        else:
            text = heads[kind] + rows(places.tolist()) + rows([(count, *range(count))])
        path.write_text(text)
        vertices, faces = read_mesh(path)
        a, b, c = vertices[faces].unbind(1)
        found = (b - a).cross(c - a, dim=1).norm(dim=1).sum() / 2
        assert float(found) == pytest.approx(area)


def test_a_polygon_that_crosses_itself_or_has_no_area_is_left() -> None:
    for corners in ([(0, 0), (2, 2), (2, 0), (0, 2)], [(0, 0), (1, 0), (2, 0), (3, 0)]):
        assert triangulated(np.array([(*corner, 0.0) for corner in corners])) is None


FLOATS = "property float x\nproperty float y\nproperty float z\n"
LIST = "property list uchar int vertex_indices\n"


def ply(form: str, faces: list, more: str = "", face_more: str = "", between: str = "") -> str:
    return (
        f"ply\nformat {form} 1.0\ncomment element face 99\nobj_info x\nelement vertex 8\n"
        f"{FLOATS}{more}{between}element face {len(faces)}\n{LIST}{face_more}end_header\n"
    )


def counted(faces: list) -> list:
    return [(len(face), *face) for face in faces]


@pytest.mark.parametrize("faces", [TRIANGLES, QUADS, MIXED])
def test_polygon_files_in_text(tmp_path: Path, faces: list) -> None:
    colours = "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty float w\n"
    head = ply("ascii", faces, colours, "property uchar flag\n")
    text = head + rows(CORNERS, "{} 9 8 7 0.5") + rows(counted(faces), "{} 1")
    for each in (text, text.replace("\n", "\r\n")):
        (tmp_path / "cube.ply").write_bytes(each.encode())
        require_cube(tmp_path / "cube.ply")


@pytest.mark.parametrize("faces", [TRIANGLES, QUADS, MIXED])
@pytest.mark.parametrize(("form", "order"), [("little", "<"), ("big", ">")])
def test_polygon_files_in_binary(tmp_path: Path, faces: list, form: str, order: str) -> None:
    edge = "element edge 1\nproperty int vertex1\nproperty int vertex2\n"
    head = ply(f"binary_{form}_endian", faces, "property ushort q\n", "property uchar f\n", edge)
    body = b"".join(struct.pack(f"{order}3fH", *corner, 7) for corner in CORNERS)
    body += struct.pack(f"{order}2i", 0, 1)
    for face in faces:
        body += struct.pack(f"{order}B{len(face)}iB", len(face), *face, 9)
    for content in (head.encode() + body, head.encode() + body + b"\n"):
        (tmp_path / "cube.ply").write_bytes(content)
        require_cube(tmp_path / "cube.ply")


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_lists_of_each_corner_are_cut_with_their_face(tmp_path: Path, kind: str) -> None:
    """Places in a texture, of which a polygon has two numbers a corner."""
    head = ply(kind, MIXED, face_more="property list uchar float texcoord\nproperty uchar flag\n")
    told = [(len(face), *face, 2 * len(face), *[0] * (2 * len(face)), 1) for face in MIXED]
    if kind == "ascii":
        body = (rows(CORNERS) + "\n" + rows(told)).encode()
    else:
        order = "<" if "little" in kind else ">"
        body = b"".join(struct.pack(f"{order}3f", *corner) for corner in CORNERS)
        for row in told:
            form = f"{order}B{row[0]}iB{2 * row[0]}fB"
            body += struct.pack(form, *row)
    (tmp_path / "cube.ply").write_bytes(head.encode() + body)
    require_cube(tmp_path / "cube.ply")


def test_rows_whose_lengths_cancel(tmp_path: Path) -> None:
    """4, 3 and 5 corners take as many bytes as three times 4."""
    faces = [(0, 1, 3, 2), (4, 6, 7), (0, 4, 5, 1, 0)]
    head = ply("binary_little_endian", faces)
    body = b"".join(struct.pack("<3f", *corner) for corner in CORNERS)
    body += b"".join(struct.pack(f"<B{len(face)}i", len(face), *face) for face in faces)
    (tmp_path / "some.ply").write_bytes(head.encode() + body)
    vertices, read = read_mesh(tmp_path / "some.ply")
    a, b, c = vertices[read].unbind(1)
    assert float((b - a).cross(c - a, dim=1).norm(dim=1).sum() / 2) == pytest.approx(4 + 2 + 4)


def binary_stl(begins: bytes) -> bytes:
    places = np.array(CORNERS, "<f4")[np.array(TRIANGLES)].reshape(-1, 9)
    head = begins.ljust(80, b"\0") + struct.pack("<I", len(places))
    return head + b"".join(struct.pack("<12fH", 0, 0, 0, *place, 0) for place in places)


def text_stl(name: str, faces: list) -> str:
    text = f"solid {name}\n"
    for face in faces:
        corners = rows([CORNERS[k] for k in face], "   vertex {}")
        text += f" facet normal 0 0 0\n  outer loop\n{corners}  endloop\n endfacet\n"
    return text + f"endsolid {name}\n"


@pytest.mark.parametrize(
    "content",
    [
        binary_stl(b""),
        binary_stl(b"solid facet outer loop vertex 1 2 3"),
        binary_stl(b"solid cube") + b"\0\n",
        text_stl("cube", TRIANGLES).encode(),
        text_stl("vertex 1 2 3 solid", TRIANGLES).encode(),
        text_stl("", TRIANGLES).upper().replace("\n", "\r\n").encode(),
        text_stl("cube", TRIANGLES).replace("\n", "\r").encode(),
        text_stl("cube", TRIANGLES).replace("\n", " ").encode(),
        b"\xef\xbb\xbf\n  " + text_stl("cube", TRIANGLES).encode(),
        (text_stl("a", TRIANGLES[:7]) + text_stl("b", TRIANGLES[7:])).encode(),
    ],
)
def test_stereolithography(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "cube.stl").write_bytes(content)
    require_cube(tmp_path / "cube.stl")


@pytest.mark.parametrize("kind", ["OFF", "COFF", "NOFF", "OFF 8"])
@pytest.mark.parametrize("faces", [TRIANGLES, QUADS, MIXED])
def test_object_file_format(tmp_path: Path, kind: str, faces: list) -> None:
    more = {"COFF": "{} 255 0 0 255", "NOFF": "{} 0 0 1"}.get(kind, "{}")
    ended = f"{kind} {len(faces)} 0\n" if kind == "OFF 8" else f"{kind}\n8 {len(faces)} 0\n"
    text = ended + rows(CORNERS, more) + "# faces\n" + rows(counted(faces), "{} 1.0 0 0")
    for each in (text, text.replace("\n", "\r\n"), "\ufeff" + text, text.replace(" ", "\t")):
        (tmp_path / "cube.off").write_bytes(each.encode())
        require_cube(tmp_path / "cube.off")
