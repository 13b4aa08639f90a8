"""One cube in the forms that glTF 2.0 allows, and what is refused by its name."""

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from skylight.errors import InputError
from skylight.probes.partitions.relight._scene import read_scene
from skylight.transport._mesh import read_mesh
from tests.transport.test_mesh_dialects import CORNERS, QUADS, TRIANGLES, require_cube

TYPES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
PLACES = np.array(CORNERS, "<f4")
INDEX = np.array(TRIANGLES, "<u2").reshape(-1, 1)


class Gltf:
    """A scene put together from arrays."""

    def __init__(self, **tree: Any) -> None:
        self.bytes = b""
        self.tree: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [],
            "accessors": [],
            "bufferViews": [],
            **tree,
        }

    def view(self, content: bytes, **more: Any) -> int:
        self.bytes += bytes(-len(self.bytes) % 4)
        place = {"buffer": 0, "byteOffset": len(self.bytes), "byteLength": len(content)}
        self.tree["bufferViews"].append({**place, **more})
        self.bytes += content
        return len(self.tree["bufferViews"]) - 1

    def add(self, rows: np.ndarray, stride: int = 0, **more: Any) -> int:
        kind = {"componentType": TYPES[rows.dtype.str[1:]], "type": SHAPES[rows.shape[1]]}
        if stride:
            row = rows.dtype.itemsize * rows.shape[1]
            content = b"".join(each.tobytes().ljust(stride, b"\7") for each in rows)
            content = content[: len(content) - stride + row]
            view = self.view(content, byteStride=stride)
        else:
            view = self.view(rows.tobytes())
        self.tree["accessors"].append({"bufferView": view, "count": len(rows), **kind, **more})
        return len(self.tree["accessors"]) - 1

    def mesh(self, *parts: dict, **more: Any) -> "Gltf":
        self.tree["meshes"].append({"primitives": list(parts), **more})
        return self

    def glb(self, path: Path) -> Path:
        body = self.bytes + bytes(-len(self.bytes) % 4)
        text = json.dumps({**self.tree, "buffers": [{"byteLength": len(body)}]}).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(body), 0x004E4942) + body
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return path


def cube(places: np.ndarray = PLACES, index: np.ndarray = INDEX, **more: Any) -> Gltf:
    made = Gltf()
    attributes = {"POSITION": made.add(places, **more)}
    return made.mesh({"attributes": attributes, "indices": made.add(index)})


@pytest.mark.parametrize("kind", ["u1", "u2", "u4"])
def test_indices_of_any_size(tmp_path: Path, kind: str) -> None:
    require_cube(cube(index=INDEX.astype("<" + kind)).glb(tmp_path / "a.glb"))


@pytest.mark.parametrize("kind", ["i1", "i2", "u1", "u2"])
@pytest.mark.parametrize("normalized", [False, True])
def test_quantised_places(tmp_path: Path, kind: str, normalized: bool) -> None:
    """KHR_mesh_quantization: the node's matrix brings them back."""
    most = np.iinfo(kind).max
    codes = np.where(PLACES > 0, most, 0 if kind[0] == "u" else -most).astype("<" + kind)
    made = cube(codes, stride=8, normalized=normalized)
    made.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    unit = 1.0 if normalized else 1.0 / most
    scale, move = (2 * unit, -1) if kind[0] == "u" else (unit, 0)
    made.tree["nodes"][0] |= {"scale": [scale] * 3, "translation": [move] * 3}
    path = made.glb(tmp_path / "a.glb")
    places = read_mesh(path)[0]
    torch.testing.assert_close(places.abs(), torch.ones_like(places))


def test_the_least_code_is_minus_one(tmp_path: Path) -> None:
    codes = np.where(PLACES > 0, 127, -128).astype("<i1")
    require_cube(cube(codes, stride=4, normalized=True).glb(tmp_path / "a.glb"))


@pytest.mark.parametrize("based", [False, True])
def test_sparse_places(tmp_path: Path, based: bool) -> None:
    """Some rows are replaced, of zeros or of other rows (3.6.2.3)."""
    at = np.array([1, 4, 7] if based else range(8), "<u1")
    places = PLACES.copy()
    places[at] = 9
    made = Gltf()
    number = made.add(places)
    accessor = made.tree["accessors"][number]
    if not based:
        del accessor["bufferView"]
    accessor["sparse"] = {
        "count": len(at),
        "indices": {"bufferView": made.view(at.tobytes()), "componentType": 5121},
        "values": {"bufferView": made.view(PLACES[at].tobytes())},
    }
    made.mesh({"attributes": {"POSITION": number}, "indices": made.add(INDEX)})
    require_cube(made.glb(tmp_path / "a.glb"))


@pytest.mark.parametrize("listed", [False, True])
@pytest.mark.parametrize(
    ("mode", "order"), [(4, [0, 1, 2, 0, 2, 3]), (5, [0, 1, 3, 2]), (6, [0, 1, 2, 3])]
)
def test_lists_strips_and_fans(tmp_path: Path, mode: int, order: list, listed: bool) -> None:
    made = Gltf()
    parts = []
    for quad in QUADS:
        corners = np.array(quad)[order]
        if listed:
            part = {"attributes": {"POSITION": made.add(PLACES)}}
            part["indices"] = made.add(corners[:, None].astype("<u1"))
        else:
            part = {"attributes": {"POSITION": made.add(PLACES[corners])}}
        parts.append({**part, "mode": mode})
    require_cube(made.mesh(*parts).glb(tmp_path / "a.glb"))


def test_lines_beside_it_are_left_out(tmp_path: Path) -> None:
    made = cube()
    place = made.add(9 * PLACES)
    made.tree["meshes"][0]["primitives"].append({"attributes": {"POSITION": place}, "mode": 1})
    require_cube(made.glb(tmp_path / "a.glb"))


def test_nodes_turn_scale_and_move_what_hangs_on_them(tmp_path: Path) -> None:
    """T R S of a parent with a camera over a matrix that undoes it; what no scene shows is away."""
    made = cube()
    half = 0.5**0.5
    turn = np.array([[0.0, 0, 2, 3], [0, 2, 0, 0], [-2, 0, 0, 0], [0, 0, 0, 1]])  # 90 about Y
    made.tree["nodes"] = [
        {"children": [2], "camera": 0, "rotation": [0, half, 0, half], "scale": [2] * 3,
         "translation": [3, 0, 0]},
        {"mesh": 0, "translation": [50, 0, 0]},
        {"mesh": 0, "matrix": np.linalg.inv(turn).T.reshape(-1).tolist()},
    ]  # fmt: skip
    vertices, _ = read_mesh(made.glb(tmp_path / "a.glb"))
    torch.testing.assert_close(vertices.abs(), torch.ones_like(vertices))


def test_morph_targets_and_skins_stand_as_the_file_says(tmp_path: Path) -> None:
    """Half the target's way; two joints of one matrix each, whose shares add to one."""
    made = Gltf()
    part = {
        "attributes": {
            "POSITION": made.add(PLACES - np.array([0, 5, 0.5], "<f4")),
            "JOINTS_0": made.add(np.tile(np.array([0, 1, 0, 0], "<u1"), (8, 1))),
            "WEIGHTS_0": made.add(
                np.tile(np.array([51, 204, 0, 0], "<u1"), (8, 1)), normalized=True
            ),
        },
        "targets": [{"POSITION": made.add(np.tile(np.array([[0, 0, 1]], "<f4"), (8, 1)))}],
        "indices": made.add(INDEX),
    }
    back = np.tile(np.eye(4, dtype="<f4"), (2, 1, 1))
    back[:, 3, 0] = -7  # by columns
    made.tree["skins"] = [{"joints": [1, 2], "inverseBindMatrices": made.add(back.reshape(2, 16))}]
    made.tree["scenes"] = [{"nodes": [0, 1]}]
    made.tree["nodes"] = [
        {"mesh": 0, "skin": 0, "weights": [0.5], "translation": [100, 0, 0]},
        {"translation": [7, 5, 0], "children": [2]},
        {},
    ]
    require_cube(made.mesh(part).glb(tmp_path / "a.glb"))


@pytest.mark.parametrize("name", ["my data ü.bin", "50% grey.bin"])
def test_buffers_beside_it_by_an_encoded_name(tmp_path: Path, name: str) -> None:
    made = cube()
    (tmp_path / name).write_bytes(made.bytes)
    uri = name.replace("%", "%25").replace(" ", "%20").replace("ü", "%C3%BC")
    for each in (
        uri,
        f"data:application/octet-stream;base64,{base64.b64encode(made.bytes).decode()}",
    ):
        tree = {**made.tree, "buffers": [{"uri": each, "byteLength": len(made.bytes)}]}
        (tmp_path / "a.gltf").write_text(json.dumps(tree), encoding="utf-8")
        require_cube(tmp_path / "a.gltf")


@pytest.mark.parametrize("kind", ["f4", "u1", "u2"])
def test_base_colour_and_places_in_its_picture(tmp_path: Path, kind: str) -> None:
    """Colours at the vertices times the material's; a picture by its own set, moved and turned."""
    made = Gltf()
    most = 1 if kind == "f4" else np.iinfo(kind).max
    colour = np.array([[1.0, 0.4, 0.2]] * 8) * most
    colour = (colour if kind == "f4" else colour.round()).astype("<" + kind)
    attributes = {
        "POSITION": made.add(PLACES),
        "COLOR_0": made.add(colour, stride=12, normalized=kind != "f4"),
        "TEXCOORD_1": made.add(
            np.full((8, 2), most, "<" + kind), stride=8, normalized=kind != "f4"
        ),
    }
    part = {"attributes": attributes, "indices": made.add(INDEX), "material": 0}
    made.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 1, 1]}}]
    path = made.mesh(part).glb(tmp_path / "a.glb")
    expected = torch.tensor([0.5, 0.2, 0.2]).double().expand(8, 3)
    torch.testing.assert_close(read_scene(path).albedo[:8], expected, atol=1 / 255, rtol=0)
    picture = Image.new("RGB", (4, 4), (0, 0, 0))
    picture.paste((255, 255, 255), (0, 2, 2, 4))  # the lower left quarter
    picture.save(tmp_path / "a b.png")
    made.tree |= {"images": [{"uri": "a%20b.png"}], "textures": [{"source": 0}]}
    # (1, 1) by 0.5 is (0.5, 0.5), turned by -90 degrees (-0.5, 0.5), moved (0.25, 0.75)
    moved = {"scale": [0.5, 0.5], "rotation": -np.pi / 2, "offset": [0.75, 0.25]}
    base = {"index": 0, "texCoord": 1, "extensions": {"KHR_texture_transform": moved}}
    made.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": base}}]
    scene = read_scene(made.glb(tmp_path / "a.glb"))
    assert scene.uv is not None
    torch.testing.assert_close(
        scene.uv, torch.tensor([0.25, 1 - 0.75]).double().expand_as(scene.uv), atol=1e-6, rtol=0
    )
    torch.testing.assert_close(scene.albedo, torch.ones_like(scene.albedo))


def test_base_colour_of_the_older_materials(tmp_path: Path) -> None:
    """KHR_materials_pbrSpecularGlossiness has picture and colour of its own."""
    made = Gltf()
    attributes = {
        "POSITION": made.add(PLACES),
        "TEXCOORD_0": made.add(np.full((8, 2), 0.5, "<f4")),
    }
    part = {"attributes": attributes, "indices": made.add(INDEX), "material": 0}
    Image.new("RGB", (4, 4), (255, 0, 0)).save(tmp_path / "red.png")
    made.tree |= {"images": [{"uri": "red.png"}], "textures": [{"source": 0}]}
    older = {"diffuseTexture": {"index": 0}, "diffuseFactor": [1, 1, 1, 1]}
    made.tree["materials"] = [{"extensions": {"KHR_materials_pbrSpecularGlossiness": older}}]
    albedo = read_scene(made.mesh(part).glb(tmp_path / "a.glb")).albedo
    torch.testing.assert_close(albedo, torch.tensor([1.0, 0, 0]).double().expand_as(albedo))


def required(name: str) -> Gltf:
    made = cube()
    made.tree["extensionsRequired"] = ["KHR_materials_unlit", name]
    return made


def without_bytes() -> Gltf:
    made = cube()
    del made.tree["accessors"][0]["bufferView"]
    return made


def versioned(version: str) -> Gltf:
    made = cube()
    made.tree["asset"]["version"] = version
    return made


def beyond() -> Gltf:
    made = cube()
    made.tree["accessors"][0]["count"] = 9
    return made


@pytest.mark.parametrize(
    ("made", "reason"),
    [
        (required("KHR_draco_mesh_compression"), "the extension KHR_draco_mesh_compression"),
        (required("EXT_meshopt_compression"), "the extension EXT_meshopt_compression"),
        (required("KHR_texture_basisu"), "the extension KHR_texture_basisu"),
        (required("EXT_mesh_gpu_instancing"), "the extension EXT_mesh_gpu_instancing"),
        (required("ACME_new"), "the extension ACME_new"),
        (without_bytes(), "accessor 0 has no bytes"),
        (versioned("1.0"), r"glTF 1\.0, where 2\.0 is read"),
        (cube(index=INDEX[:4]), "4 corners, not three each"),
        (cube(places=0 * PLACES), "none of its 12 triangles has an area"),
        (cube(index=0 * INDEX), "none of its 12 triangles has an area"),
        (cube(places=PLACES * np.array([1, 0, 0], "<f4")), "none of its 12 triangles has an area"),
        (beyond(), "cut short"),
    ],
)
def test_what_is_not_read_is_named(tmp_path: Path, made: Gltf, reason: str) -> None:
    path = made.glb(tmp_path / "a.glb")
    for read in (read_mesh, read_scene):
        with pytest.raises(InputError, match=reason):
            read(path)


@pytest.mark.parametrize(
    ("uri", "reason"),
    [
        ("gone%20away.bin", r"its gone away\.bin is not there"),
        ("../a.bin", "outside of its folder"),
    ],
)
def test_files_beside_it_that_are_not(tmp_path: Path, uri: str, reason: str) -> None:
    made = cube()
    tree = {**made.tree, "buffers": [{"uri": uri, "byteLength": len(made.bytes)}]}
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    with pytest.raises(InputError, match=reason):
        read_mesh(tmp_path / "a.gltf")


def test_a_buffer_that_an_extension_alone_fills(tmp_path: Path) -> None:
    made = cube()
    tree = {**made.tree, "buffers": [{"byteLength": len(made.bytes)}]}
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    with pytest.raises(InputError, match="its buffer 0 has no bytes"):
        read_mesh(tmp_path / "a.gltf")
