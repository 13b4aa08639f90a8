"""Small files that claim, or unpack to, very much; read in a process whose memory is watched.

``python -m tests.faults.bombs FOLDER`` writes each, has it read, and prints
{name: [error's type, its message, MB that the process grew by, seconds]}.
"""

import gzip
import json
import resource
import struct
import sys
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from onnx import TensorProto, helper, numpy_helper

from skylight.csc._code import SparseCode
from skylight.csc._dictionary import FilterBank
from skylight.imaging._photo import read_photo
from skylight.io._files import read_environment_map
from skylight.io._tensors import write_tensors
from skylight.models._bundle import load_network
from skylight.probes.cameras._live import read_picture
from skylight.probes.partitions.relight._scene import read_scene
from skylight.probes.partitions.relight._transfer import load_transfer
from skylight.probes.voxel._lightmap import load_lightmap
from skylight.probes.voxel._model import read_voxels
from skylight.relight._decoder import SkyDecoder
from skylight.relight._runtime import PrecomputedScene, load_scene
from skylight.skies._index import read_index
from skylight.training._config import read_config
from skylight.transport._mesh import read_mesh
from tests.imaging.test_raw import LONG, Entry, mosaic, write_dng
from tests.peak_memory import peak_mb

LIGHTMAP = ("version", "radiance", "coverage", "confidence", "faces", "rotation")
SCENE = tuple(PrecomputedScene.__dataclass_fields__)
BUDGET_MB = 6000  # beyond what is there: a test that fails should not take the machine with it


def exr(width: int, height: int, channels: tuple[str, ...] = ("B", "G", "R")) -> bytes:
    """An OpenEXR header of so many float pixels, with no pixels behind it."""

    def attribute(name: bytes, kind: bytes, value: bytes) -> bytes:
        return name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value

    one = struct.pack("<iBBBBii", 2, 0, 0, 0, 0, 1, 1)
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    listed = b"".join(name.encode() + b"\0" + one for name in channels) + b"\0"
    return b"".join(
        [
            struct.pack("<II", 20000630, 2),
            attribute(b"channels", b"chlist", listed),
            attribute(b"compression", b"compression", b"\3"),
            attribute(b"dataWindow", b"box2i", box),
            attribute(b"displayWindow", b"box2i", box),
            attribute(b"lineOrder", b"lineOrder", b"\0"),
            attribute(b"pixelAspectRatio", b"float", struct.pack("<f", 1)),
            attribute(b"screenWindowCenter", b"v2f", struct.pack("<ff", 0, 0)),
            attribute(b"screenWindowWidth", b"float", struct.pack("<f", 1)),
            b"\0" * 1000,
        ]
    )


def hdr(width: int, height: int) -> bytes:
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n"
    return head.encode() + b"\2\2\0\x40" * 100


def png(width: int, height: int) -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        check = struct.pack(">I", zlib.crc32(kind + content))
        return struct.pack(">I", len(content)) + kind + content + check

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    pixels = zlib.compress(b"\0" * 2**24, 9)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")
    )


def tiff(width: int, height: int) -> bytes:
    """One strip, eight bits, RGB, deflated."""
    pixels = zlib.compress(b"\0" * 2**20)
    tags = [
        (256, 4, 1, width), (257, 4, 1, height), (258, 3, 1, 8), (259, 3, 1, 8), (262, 3, 1, 2),
        (273, 4, 1, 8), (277, 3, 1, 3), (278, 4, 1, height), (279, 4, 1, len(pixels)),
    ]  # fmt: skip
    listed = b"".join(struct.pack("<HHII", *tag) for tag in tags)
    head = b"II*\0" + struct.pack("<I", 8 + len(pixels))
    return head + pixels + struct.pack("<H", len(tags)) + listed + b"\0" * 4


def jpeg(width: int, height: int) -> bytes:
    """A frame header of so many pixels, then nothing."""
    frame = struct.pack(">BHHB", 8, height, width, 3) + b"\1\x11\0\2\x11\0\3\x11\0"
    return b"\xff\xd8\xff\xc0" + struct.pack(">H", len(frame) + 2) + frame + b"\xff\xd9"


def npy(shape: tuple[int, ...], descr: str = "<f4") -> bytes:
    head = repr({"descr": descr, "fortran_order": False, "shape": shape}).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head


def packed(path: Path, members: dict[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def swollen(path: Path, names: tuple[str, ...], mb: int) -> None:
    """An archive of members of so many MB of zeros, written in pieces."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            with archive.open(name, "w", force_zip64=True) as stream:
                stream.write(npy((mb * 2**18,)))
                for _ in range(mb):
                    stream.write(b"\0" * 2**20)


def lying(path: Path, names: tuple[str, ...]) -> None:
    """An archive of arrays of 256 GB by their headers, and without numbers."""
    packed(path, {f"{name}.npy": npy((2**36,)) for name in names})


def glb(accessors: list[dict[str, object]], nodes: int = 1) -> bytes:
    scene = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(nodes))}],
        "nodes": [{"mesh": 0}] * nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": accessors,
        "bufferViews": [{"buffer": 0, "byteLength": 3_600_000, "byteStride": 1}],
        "buffers": [{"byteLength": 3_600_000}],
    }
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text
    body += struct.pack("<II", 3_600_000, 0x004E4942) + b"\0" * 3_600_000
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def graph(nodes: list[object], weights: list[object], **model: object) -> bytes:
    made = helper.make_graph(
        nodes,
        "decoder",
        [helper.make_tensor_value_info("latent", TensorProto.FLOAT, ["b", 64])],
        [helper.make_tensor_value_info("radiance", TensorProto.FLOAT, ["b", 32, 128, 3])],
        weights,
    )
    opsets = [helper.make_opsetid("", 18), *model.pop("opsets", ())]  # type: ignore[misc]
    whole = helper.make_model(made, opset_imports=opsets, ir_version=9, **model)
    helper.set_model_props(whole, {"centre_azimuth_rad": "0.02"})
    return whole.SerializeToString()


def huge_graph() -> bytes:
    """32 GB in the middle, from a scalar."""
    inits = {
        "one": np.ones((1, 1), np.float32), "big": np.array([2**33, 1]), "all": np.array([0, 1]),
        "shape": np.array([1, 32, 128, 3]),
    }  # fmt: skip
    return graph(
        [
            helper.make_node("ReduceSum", ["latent", "all"], ["s"]),
            helper.make_node("Add", ["s", "one"], ["t"]),
            helper.make_node("Expand", ["t", "big"], ["e"]),
            helper.make_node("ReduceSum", ["e", "all"], ["r"]),
            helper.make_node("Expand", ["r", "shape"], ["radiance"]),
        ],
        [numpy_helper.from_array(value, name) for name, value in inits.items()],
    )


def outside_graph() -> bytes:
    tensor = numpy_helper.from_array(np.zeros((64, 1), np.float32), "w")
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="../../../../etc/passwd")
    return graph([helper.make_node("MatMul", ["latent", "w"], ["radiance"])], [tensor])


def decode(path: Path) -> None:
    SkyDecoder(path).decode(np.zeros((1, 64), np.float32))


def _dng(side: int, *more: Entry) -> Callable[[Path], object]:
    """A RAW file of 32 x 32 pixels that claims more."""
    sides: list[Entry] = [(tag, LONG, [side]) for tag in (256, 257, 278)]
    return lambda path: write_dng(path, mosaic()[:32, :32], claimed=[*sides, *more])


def _write(path: Path, content: bytes) -> None:
    path.write_bytes(content)


def _zeros_obj(path: Path) -> None:
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9999999999\n")


_ZEROS = {"componentType": 5126, "count": 10**9, "type": "MAT4"}
_STRIDED = {"bufferView": 0, "componentType": 5126, "count": 3_500_000, "type": "MAT4"}
_POINTS = {"bufferView": 0, "componentType": 5126, "count": 3_500_000, "type": "VEC3"}
_LOOP = helper.make_node(
    "If",
    ["c"],
    ["radiance"],
    then_branch=helper.make_graph([], "a", [], []),
    else_branch=helper.make_graph([], "b", [], []),
)
_CUSTOM = helper.make_node("Anything", ["latent"], ["radiance"], domain="com.example")
_ENDS = helper.make_node("Identity", ["latent"], ["radiance"])

# name: (write, read)
BOMBS: dict[str, tuple[Callable[[Path], object], Callable[[Path], object]]] = {
    "wide.exr": (lambda p: _write(p, exr(40_000, 20_000)), read_environment_map),
    "channels.exr": (
        lambda p: _write(p, exr(8192, 4096, tuple(f"c{i:03d}" for i in range(200)))),
        read_environment_map,
    ),
    "endless.exr": (lambda p: _write(p, exr(2**30, 2**29)), read_environment_map),
    "wide.hdr": (lambda p: _write(p, hdr(40_000, 20_000)), read_environment_map),
    "short.hdr": (lambda p: _write(p, hdr(16_384, 8192)), read_environment_map),
    "endless.hdr": (lambda p: _write(p, hdr(2**31 - 1, 2**31 - 1)), read_environment_map),
    "wide.png": (lambda p: _write(p, png(40_000, 40_000)), read_photo),
    "square.png": (lambda p: _write(p, png(13_000, 13_000)), read_photo),
    "board.png": (lambda p: _write(p, png(13_000, 13_000)), read_picture),
    "wide.tif": (lambda p: _write(p, tiff(60_000, 60_000)), read_photo),
    "wide.jpg": (lambda p: _write(p, jpeg(65_500, 65_500)), read_photo),
    "wide.dng": (_dng(40_000), read_photo),
    "margins.dng": (_dng(30_000, (50829, LONG, [0, 0, 32, 32])), read_photo),  # 32 x 32 are shown
    "pipe.jpg": (lambda p: p.symlink_to("/dev/zero"), read_photo),
    "lying.npz": (lambda p: lying(p, LIGHTMAP), load_lightmap),
    "swollen.npz": (
        lambda p: swollen(p, tuple(f"{name}.npy" for name in LIGHTMAP), 200),
        load_lightmap,
    ),
    "scene.npz": (lambda p: lying(p, ("format", *SCENE)), load_scene),
    "transfer.npz": (lambda p: lying(p, ("version", "key", "values", "orders")), load_transfer),
    "grid.npy": (lambda p: _write(p, npy((2**11, 2**11, 2**11), "|b1")), read_voxels),
    "wide.vox": (
        lambda p: _write(
            p,
            b"VOX " + struct.pack("<i", 150) + b"MAIN" + struct.pack("<ii", 0, 100)
            + b"SIZE" + struct.pack("<5i", 12, 0, 2**15, 2**15, 2**15)
            + b"XYZI" + struct.pack("<iiI", 8, 0, 2**32 - 1) + b"\0" * 4,
        ),
        read_voxels,
    ),
    "zeros.glb": (lambda p: _write(p, glb([_ZEROS])), read_mesh),
    "strides.glb": (lambda p: _write(p, glb([_STRIDED] * 100)), read_mesh),
    "instances.glb": (lambda p: _write(p, glb([_POINTS], nodes=1000)), read_scene),
    "far.obj": (_zeros_obj, read_mesh),
    "many.ply": (
        lambda p: _write(
            p,
            b"ply\nformat binary_little_endian 1.0\nelement vertex 2000000000\n"
            b"property float x\nproperty float y\nproperty float z\nend_header\n" + b"\0" * 99,
        ),
        read_mesh,
    ),
    "many.stl": (
        lambda p: _write(p, b"\0" * 80 + struct.pack("<I", 2**32 - 1) + b"\0" * 50),
        read_mesh,
    ),
    "deep.json": (lambda p: p.write_text("[" * 10**6), SparseCode.load),
    "huge.json": (lambda p: p.write_bytes(b" " * (2**26 + 1)), SparseCode.load),
    "packed.json": (lambda p: p.write_bytes(gzip.compress(b"{}" * 10**6)), SparseCode.load),
    "huge.csv": (lambda p: p.write_bytes(b"a," * (2**25 + 1)), read_index),
    "laughs.yaml": (
        lambda p: p.write_text(
            "a0: &a0 [x, x, x, x, x, x, x, x, x]\n"
            + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 12))
            + "kind: autoencoder\nepochs: *a11\n"
        ),
        read_config,
    ),
    "header.safetensors": (
        lambda p: _write(p, struct.pack("<Q", 2**40) + b"{}"),
        FilterBank.load,
    ),
    "latents.safetensors": (
        lambda p: write_tensors(p, {"linear.weight": torch.zeros(0, 10**9)}),
        load_network,
    ),
    "huge.onnx": (lambda p: _write(p, huge_graph()), decode),
    "outside.onnx": (lambda p: _write(p, outside_graph()), decode),
    "branches.onnx": (lambda p: _write(p, graph([_LOOP], [])), decode),
    "custom.onnx": (
        lambda p: _write(p, graph([_CUSTOM], [], opsets=[helper.make_opsetid("com.example", 1)])),
        decode,
    ),
    "ends.onnx": (lambda p: _write(p, graph([_ENDS], [])), decode),
}  # fmt: skip


def main(folder: Path) -> None:
    decode_started = resource.getrlimit(resource.RLIMIT_AS)
    size_kb = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size_kb + BUDGET_MB * 2**20, decode_started[1]))
    told = {}
    for name, (write, read) in BOMBS.items():
        path = folder / name
        write(path)
        before = peak_mb()
        started = time.monotonic()
        try:
            read(path)
            kind, line = "", ""
        except Exception as error:
            kind, line = type(error).__name__, str(error)
        seconds = time.monotonic() - started
        grown = peak_mb() - before
        told[name] = [kind, line, grown, seconds]
        path.unlink()
    print(json.dumps(told))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
