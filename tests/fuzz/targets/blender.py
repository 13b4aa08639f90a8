"""What the extension for Blender reads: skylight's version and progress, a scene and a head."""

import json

from blender.world_from_portrait.commands import check_version
from blender.world_from_portrait.run import Failure, parse_progress
from blender.world_from_portrait.scene_file import KIND, NAME, VERSION, read_head, read_scene
from blender.world_from_portrait.wording import of_verdict
from skylight.errors import InputError
from tests.fuzz.files import PLACE, clear, joined, parted

_FOLDER = PLACE / "blender"
_HEAD = "head.obj"
_SUN = {
    "name": "sun", "towards": [0, 0.6, 0.8], "colour": [1, 0.9, 0.8], "energy": 2.5,
    "angle_rad": 0.0093,
}  # fmt: skip
_SCENE = {
    "kind": KIND, "version": VERSION, "world": "light.hdr", "suns": [_SUN],
    "photograph": "photograph.png", "photograph_px": [60, 80], "focal_length_px": 120.5,
    "head": _HEAD, "albedo": [0.5, 0.4, 0.3], "ior": 1.4, "roughness": 0.5,
    "white": [0.8, 0.7, 0.6],
    "verdict": "direction rough, brightness rough, colour sure", "advice": ["a", "b"],
}  # fmt: skip


def seeds() -> list[bytes]:
    scene = json.dumps(_SCENE).encode()
    head = b"# head\nv 0 0 -1\nv 1 0 -1\nv 0 1 -2\nf 1 2 3\n"
    return [
        joined({NAME: scene, _HEAD: head}),
        joined({"version": b"skylight 0.2.0\n"}),
        joined({"progress": b'{"stage": "tracing light", "share": 0.25}\n'}),
    ]


def read(content: bytes) -> None:
    members = parted(content)
    try:
        _read(members)
    except Failure as failure:
        raise InputError(clear(failure)) from failure


def _read(members: dict[str, bytes]) -> None:
    text = {name: data.decode("utf-8", "replace") for name, data in members.items()}
    for line in text.get("progress", "").splitlines(keepends=True):
        parse_progress(line)
    if "version" in text:
        check_version(text["version"])
    if NAME in members:
        _FOLDER.mkdir(exist_ok=True)
        for name in ("light.hdr", "photograph.png"):
            (_FOLDER / name).touch()
        for name in (NAME, _HEAD):
            (_FOLDER / name).write_bytes(members.get(name, b""))
        scene = read_scene(_FOLDER)
        of_verdict(scene.verdict)
        read_head(scene.head)
