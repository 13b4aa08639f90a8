"""glTF 2.0 in its plainest form: float32 attributes, lists of triangles, one level of nodes.

trimesh takes quantised, normalised and sparse accessors as they lie there, and knows no triangle
fans, skins, morph targets or percent-encoded names. What it cannot know is refused by name.
https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

import base64
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np

from skylight.errors import InputError
from skylight.io._bounded import (
    ARRAY_BYTES_MAX,
    TEXT_BYTES_MAX,
    file_bytes,
    json_content,
    json_loads,
    require_bytes,
)

FACES_MAX = 50_000_000
_GLB_SHARED = 16  # so often may accessors share a file's bytes
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942
# 3.6.2.2
_DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
# required of readers, and read; those of materials and lights leave shape and base colour alone
_READ = {"KHR_mesh_quantization", "KHR_texture_transform", "EXT_texture_webp"}
_HARMLESS = ("KHR_materials_", "KHR_lights_", "EXT_lights_", "KHR_xmp", "KHR_animation_")


def plain_glb(path: Path) -> bytes:
    """A .glb or .gltf file as a .glb that all readers understand; its pictures may lie beside it.

    Raises whatever a scene that is none makes of it, beside ValueError; InputError for what is not
    read, and for files that it names and that are not there.
    """
    size = require_bytes(path)
    if path.suffix.lower() == ".glb":
        tree, packed = _glb_parts(path, size)
        _require_scene(tree, most=2**24 + _GLB_SHARED * size)
    else:
        tree, packed = json_content(path), None
        _require_scene(tree, most=ARRAY_BYTES_MAX)
    return _Plain(path, tree, packed).content()


def _glb_parts(path: Path, size: int) -> tuple[Any, bytes | None]:
    """The scene and the bytes in the file, if any."""
    with path.open("rb") as stream:
        magic, version, whole, length, kind = struct.unpack("<4sIIII", stream.read(20))
        if magic == b"glTF" and version != 2:
            raise InputError(f"glTF {version}, where 2.0 is read; convert it")
        if magic != b"glTF" or kind != _JSON_CHUNK:
            raise ValueError("it does not begin like one")
        if max(length, whole) > size:
            raise ValueError(f"cut short: {size} bytes of {max(length, whole)}")
        if length > TEXT_BYTES_MAX:
            raise ValueError(f"a scene of {length} bytes, more than the {TEXT_BYTES_MAX} read")
        tree = json_loads(stream.read(length).decode("utf-8"))
        while len(head := stream.read(8)) == 8:
            length, kind = struct.unpack("<II", head)
            content = stream.read(length)
            if kind == _BINARY_CHUNK:
                return tree, content
    return tree, None


def _require_scene(scene: Any, most: int) -> None:
    """Refuse what is not read by its name, and accessors and instances beyond ``most`` bytes."""
    version = str(scene.get("asset", {}).get("version", "2"))
    if version.partition(".")[0] != "2":
        raise InputError(f"glTF {version}, where 2.0 is read; convert it")
    for name in scene.get("extensionsRequired", []):
        if name not in _READ and not name.startswith(_HARMLESS):
            raise InputError(f"it needs the extension {name}, which is not read; export without it")
    accessors = scene.get("accessors", [])
    counts = [int(accessor["count"]) for accessor in accessors]
    if any(count < 0 for count in counts):
        raise ValueError("an accessor of less than nothing")
    together = sum(
        count * np.dtype(_DTYPES[accessor["componentType"]]).itemsize * _NUMBERS[accessor["type"]]
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


class _Plain:
    """The scene of a file, written anew."""

    def __init__(self, path: Path, tree: Any, packed: bytes | None) -> None:
        self._path, self._tree = path, tree
        self._buffers = [
            self._named(buffer["uri"]) if "uri" in buffer else packed if number == 0 else None
            for number, buffer in enumerate(tree.get("buffers", []))
        ]
        self._bytes = bytearray()
        self._views: list[dict] = []
        self._accessors: list[dict] = []
        self._meshes: list[dict] = []

    def content(self) -> bytes:
        tree = self._tree
        for view in tree.get("bufferViews", []):  # of pictures
            self._add_view(self._view(view))
        nodes = self._drawn()
        images = [
            {**image, "uri": unquote(image["uri"])}
            if not image.get("uri", "data:").startswith("data:")
            else image
            for image in tree.get("images", [])
        ]
        plain = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": list(range(len(nodes)))}],
            "nodes": nodes,
            "meshes": self._meshes,
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._bytes)}],
            "images": images,
            "textures": tree.get("textures", []),
            "materials": [
                {**m, "pbrMetallicRoughness": _base(m)} for m in tree.get("materials", [])
            ],
        }
        text = json.dumps(plain, allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        body = struct.pack("<II", len(text), _JSON_CHUNK) + text
        body += struct.pack("<II", len(self._bytes), _BINARY_CHUNK) + self._bytes
        return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body

    def _drawn(self) -> list[dict]:
        """The meshes that the scene shows, each as one node in the world."""
        tree, nodes = self._tree, self._tree.get("nodes", [])
        scenes = tree.get("scenes", [])
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [number for number in range(len(nodes)) if number not in children]
        if scenes:
            roots = scenes[tree.get("scene", 0)].get("nodes", [])
        world: dict[int, np.ndarray] = {}
        pending = [(root, np.eye(4)) for root in reversed(roots)]
        while pending:
            number, above = pending.pop()
            if number in world:
                raise ValueError(f"its node {number} hangs in two places")
            world[number] = above @ _matrix(nodes[number])
            below = nodes[number].get("children", [])
            pending += [(child, world[number]) for child in reversed(below)]
        drawn = []
        for number, matrix in world.items():
            if "mesh" not in nodes[number]:
                continue
            joints = self._joints(nodes[number], world)
            made = self._mesh(nodes[number], joints)
            placed = np.eye(4) if joints is not None else matrix
            if made is not None:
                drawn.append({"mesh": made, "matrix": placed.T.reshape(-1).tolist()})
        return drawn

    def _joints(self, node: dict, world: dict[int, np.ndarray]) -> np.ndarray | None:
        """The matrices of a node's skin, with which its mesh is placed (3.7.3.3)."""
        if "skin" not in node:
            return None
        skin = self._tree["skins"][node["skin"]]
        joints = np.stack([world[joint] for joint in skin["joints"]])
        if "inverseBindMatrices" in skin:
            back = self._values(skin["inverseBindMatrices"]).reshape(-1, 4, 4)
            joints = joints @ back.transpose(0, 2, 1)[: len(joints)]
        return joints

    def _mesh(self, node: dict, joints: np.ndarray | None) -> int | None:
        mesh = self._tree["meshes"][node["mesh"]]
        weights = node.get("weights", mesh.get("weights", []))
        parts = [
            self._part(part, weights, joints)
            for part in mesh["primitives"]
            if part.get("mode", _TRIANGLES) in (_TRIANGLES, _STRIP, _FAN)
        ]
        if not parts:
            return None
        self._meshes.append({"primitives": parts})
        return len(self._meshes) - 1

    def _part(self, part: dict, weights: list, joints: np.ndarray | None) -> dict:
        given = part["attributes"]
        vertices = self._values(given["POSITION"])
        for weight, target in zip(weights, part.get("targets", []), strict=False):
            if weight and "POSITION" in target:
                vertices = vertices + weight * self._values(target["POSITION"])
        if joints is not None and "JOINTS_0" in given:
            vertices = self._skinned(vertices, given, joints)
        made = {"POSITION": vertices}
        if "NORMAL" in given and joints is None:
            made["NORMAL"] = self._values(given["NORMAL"])
        material = self._tree["materials"][part["material"]] if "material" in part else {}
        base = _base(material)
        picture = base.get("baseColorTexture")
        if picture is not None and (uv := self._uv(given, picture)) is not None:
            made["TEXCOORD_0"] = uv
        plain: dict[str, Any] = {"mode": _TRIANGLES}
        if "COLOR_0" in given:
            colour = self._values(given["COLOR_0"])
            made["COLOR_0"] = (
                colour * np.array(base.get("baseColorFactor", [1] * 4))[: colour.shape[1]]
            )
        # colours at the vertices stand for the material, which they are multiplied with
        if "material" in part and (picture is not None or "COLOR_0" not in given):
            plain["material"] = part["material"]
        count = len(vertices)
        index = np.arange(count) if "indices" not in part else self._raw(part["indices"])[:, 0]
        faces = _triangles(index.astype(np.uint32), part.get("mode", _TRIANGLES))
        plain["attributes"] = {
            name: self._add(values.astype("<f4")) for name, values in made.items()
        }
        plain["indices"] = self._add(faces.reshape(-1, 1).astype("<u4"))
        return plain

    def _skinned(self, vertices: np.ndarray, given: dict, joints: np.ndarray) -> np.ndarray:
        whole = np.concatenate([vertices, np.ones((len(vertices), 1))], 1)
        placed, total = np.zeros((len(vertices), 3)), np.zeros((len(vertices), 1))
        sets = 0
        while f"JOINTS_{sets}" in given:
            which, weights = (self._values(given[f"{n}_{sets}"]) for n in ("JOINTS", "WEIGHTS"))
            for joint, weight in zip(which.T.astype(int), weights.T[..., None], strict=True):
                placed += weight * np.einsum("nij,nj->ni", joints[joint][:, :3], whole)
                total += weight
            sets += 1
        return placed / np.where(total > 0, total, 1)

    def _uv(self, given: dict, picture: dict) -> np.ndarray | None:
        """Places in the base colour's picture, moved by KHR_texture_transform."""
        moved = picture.get("extensions", {}).get("KHR_texture_transform", {})
        name = f"TEXCOORD_{moved.get('texCoord', picture.get('texCoord', 0))}"
        if name not in given:
            return None
        angle = moved.get("rotation", 0.0)
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        matrix = turn * np.array(moved.get("scale", [1.0, 1.0]))
        return self._values(given[name]) @ matrix.T + np.array(moved.get("offset", [0.0, 0.0]))

    def _values(self, number: int) -> np.ndarray:
        """An accessor's rows as float64, normalised where it says so (3.6.2.2, 3.11)."""
        rows = self._raw(number)
        if self._tree["accessors"][number].get("normalized") and rows.dtype.kind in "iu":
            return np.maximum(rows / np.iinfo(rows.dtype).max, -1.0)
        return rows.astype(np.float64)

    def _raw(self, number: int) -> np.ndarray:
        accessor = self._tree["accessors"][number]
        kind, width = np.dtype(_DTYPES[accessor["componentType"]]), _NUMBERS[accessor["type"]]
        sparse = accessor.get("sparse")
        if "bufferView" in accessor:
            rows = self._rows(accessor, kind, width, accessor["count"])
        elif sparse:
            rows = np.zeros((accessor["count"], width), kind)
        else:
            raise ValueError(f"its accessor {number} has no bytes: an extension may hold them")
        if sparse:
            rows, where = rows.copy(), sparse["indices"]
            at = self._rows(where, np.dtype(_DTYPES[where["componentType"]]), 1, sparse["count"])
            rows[at[:, 0]] = self._rows(sparse["values"], kind, width, sparse["count"])
        return rows

    def _rows(self, place: dict, kind: np.dtype, width: int, count: int) -> np.ndarray:
        view = self._tree["bufferViews"][place["bufferView"]]
        row = kind.itemsize * width
        stride, start = view.get("byteStride", row), place.get("byteOffset", 0)
        content = self._view(view)
        end = start + (count - 1) * stride + row if count else start
        if min(start, count) < 0 or stride < row or end > len(content):
            raise ValueError(f"cut short: {count} rows where {len(content)} bytes are")
        return np.ndarray((count, width), kind, content, start, (stride, kind.itemsize))

    def _view(self, view: dict) -> bytes:
        content = self._buffers[view["buffer"]]
        start, length = view.get("byteOffset", 0), view["byteLength"]
        if content is None:
            raise ValueError(
                f"its buffer {view['buffer']} has no bytes: an extension may hold them"
            )
        if min(start, length) < 0 or start + length > len(content):
            raise ValueError(f"cut short: {len(content)} bytes of {start + length}")
        return content[start : start + length]

    def _named(self, uri: str) -> bytes:
        """What a buffer's URI names: a file beside the scene, or the data itself."""
        if uri.startswith("data:"):
            kind, _, data = uri.partition(",")
            return base64.b64decode(data) if kind.endswith(";base64") else unquote_to_bytes(data)
        folder = self._path.resolve().parent
        place = (folder / unquote(uri)).resolve()
        if not place.is_relative_to(folder):
            raise InputError(
                f"its {unquote(uri)} lies outside of its folder: put it beside the scene"
            )
        if not place.is_file():
            raise InputError(f"its {unquote(uri)} is not there; put it beside the scene")
        return file_bytes(place)

    def _add_view(self, content: bytes) -> None:
        self._bytes += bytes(-len(self._bytes) % 4)
        view = {"buffer": 0, "byteOffset": len(self._bytes), "byteLength": len(content)}
        self._views.append(view)
        self._bytes += content

    def _add(self, rows: np.ndarray) -> int:
        self._add_view(rows.tobytes())
        names = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
        self._accessors.append(
            {
                "bufferView": len(self._views) - 1,
                "componentType": 5126 if rows.dtype.kind == "f" else 5125,
                "count": len(rows),
                "type": names[rows.shape[1]],
            }
        )
        return len(self._accessors) - 1


def _base(material: dict) -> dict:
    """Its pbrMetallicRoughness; of KHR_materials_pbrSpecularGlossiness what is diffuse."""
    older = material.get("extensions", {}).pop("KHR_materials_pbrSpecularGlossiness", None)
    if older is not None:
        material["pbrMetallicRoughness"] = {
            "baseColorFactor": older.get("diffuseFactor", [1] * 4),
            **({"baseColorTexture": older["diffuseTexture"]} if "diffuseTexture" in older else {}),
            "metallicFactor": 0,
        }
    return material.get("pbrMetallicRoughness", {})


def _matrix(node: dict) -> np.ndarray:
    """From a node's frame to its parent's (3.5.3)."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = np.array(node.get("rotation", [0, 0, 0, 1]), np.float64)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= np.array(node.get("scale", [1, 1, 1]), np.float64)
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix


def _triangles(index: np.ndarray, mode: int) -> np.ndarray:
    """(f, 3) of a list, strip or fan of triangles (3.7.2.1); those of a strip wound alike."""
    if mode == _TRIANGLES:
        if len(index) % 3:
            raise ValueError(f"its triangles have {len(index)} corners, not three each")
        return index.reshape(-1, 3)
    if mode == _FAN:
        first = np.broadcast_to(index[:1], index[2:].shape)
        return np.stack([index[1:-1], index[2:], first], 1)
    odd = np.arange(max(0, len(index) - 2)) % 2 == 1
    a, b, c = index[:-2], index[1:-1], index[2:]
    return np.stack([a, np.where(odd, c, b), np.where(odd, b, c)], 1)
