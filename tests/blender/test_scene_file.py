"""The files between skylight and the extension: what is read, and what is refused."""

import json
from pathlib import Path
from typing import Any, get_args

import pytest

from blender.world_from_portrait.run import Failure
from blender.world_from_portrait.scene_file import KIND, NAME, VERSION, read_head, read_scene
from blender.world_from_portrait.wording import UNKNOWN, of_verdict
from skylight.inverse._verdict import Word
from skylight.relight import _blender as blender_scene

SUN: dict[str, Any] = {
    "name": "sun",
    "towards": [0, 0.6, 0.8],
    "colour": [1, 0.9, 0.8],
    "energy": 2.5,
    "angle_rad": 0.0093,
}
GOOD: dict[str, Any] = {
    "kind": KIND,
    "version": VERSION,
    "world": "light.hdr",
    "suns": [SUN],
    "photograph": "photograph.png",
    "photograph_px": [60, 80],
    "focal_length_px": 120.5,
    "head": "head.obj",
    "albedo": [0.5, 0.4, 0.3],
    "ior": 1.4,
    "roughness": 0.5,
    "white": [0.8, 0.7, 0.6],
    "verdict": "direction rough, brightness rough, colour sure",
    "advice": ["a", "b"],
}
HEAD = "# head\nv 0 0 -1\nv 1 0 -1\nv 0 1 -2\nf 1 2 3\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in (("light.hdr", ""), ("photograph.png", ""), ("head.obj", HEAD)):
        (tmp_path / name).write_text(text)
    write(tmp_path)
    return tmp_path


def write(folder: Path, **changed: object) -> None:
    (folder / NAME).write_text(json.dumps(GOOD | changed))


def test_it_is_the_format_that_skylight_writes() -> None:
    assert (NAME, KIND, VERSION) == (
        blender_scene.SCENE,
        blender_scene.KIND,
        blender_scene.VERSION,
    )


def test_a_whole_scene_is_read(folder: Path) -> None:
    scene = read_scene(folder)
    (sun,) = scene.suns
    assert (sun.name, sun.towards, sun.energy) == ("sun", (0, 0.6, 0.8), 2.5)
    assert scene.photograph_px == (60, 80)
    assert scene.world == folder / "light.hdr"
    assert scene.advice == ("a", "b")
    assert scene.white == (0.8, 0.7, 0.6)
    assert scene.estimate is None
    (folder.parent / "estimate.json").touch()
    assert read_scene(folder).estimate == folder.parent
    vertices, faces = read_head(scene.head)
    assert vertices == [(0, 1, 0), (1, 1, 0), (0, 2, 1)]  # ahead, which is +Y, and up, +Z
    assert faces == [(0, 1, 2)]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"kind": "other"}, "not a scene that skylight wrote"),
        ({"version": 1}, "version 1, this extension reads 2"),
        ({"version": None}, "version None"),
        ({"photograph_px": [60]}, "damaged"),
        ({"photograph_px": [60, 0]}, "damaged"),
        ({"photograph_px": [60.5, 80]}, "damaged"),
        ({"focal_length_px": 0}, "too small"),
        ({"focal_length_px": "12"}, "a number was expected"),
        ({"albedo": [0.5, 0.4]}, "damaged"),
        ({"albedo": [0.5, 0.4, True]}, "a number was expected"),
        ({"ior": 0.9}, "too small"),
        ({"roughness": "rough"}, "a number was expected"),
        ({"white": [0.8, -0.7, 0.6]}, "too small"),
        ({"white": [0.8, 0.7]}, "damaged"),
        ({"suns": 3}, "damaged"),
        ({"suns": [SUN | {"energy": -1}]}, "too small"),
        ({"suns": [SUN | {"towards": [0, 1e400, 0]}]}, "a number was expected"),
        ({"suns": [{"name": "sun"}]}, "damaged"),
        ({"world": "a" * 5000}, "there is no such file"),
        ({"world": "missing.hdr"}, "missing.hdr: there is no such file"),
        ({"head": 3}, "a file's name was expected"),
        ({"head": "../head.obj"}, "a file's name was expected"),
        ({"world": "light\n.hdr"}, "a file's name was expected"),
        ({"version": "1\n"}, "version '1"),
        ({"ior": 10**400}, "a number was expected"),
        ({"photograph_px": [60, 10**9]}, "a number of pixels was expected"),
    ],
)
def test_a_scene_that_cannot_be_is_one_line(
    folder: Path, changed: dict[str, object], message: str
) -> None:
    write(folder, **changed)
    with pytest.raises(Failure, match=message) as caught:
        read_scene(folder)
    assert "\n" not in str(caught.value)


def test_no_scene_is_one_line(folder: Path) -> None:
    no_json = ("{", "[" * 10**5, r'{"a": "\ud800"}')
    for text, message in (("[1]", "not a scene"), *((text, "no JSON") for text in no_json)):
        (folder / NAME).write_text(text)
        with pytest.raises(Failure, match=message):
            read_scene(folder)
    (folder / NAME).unlink()
    with pytest.raises(Failure, match="cannot be read"):
        read_scene(folder)


@pytest.mark.parametrize(
    "text",
    ["", "v 0 0 0\n", HEAD + "f 1 2 4\n", HEAD + "f 0 1 2\n", HEAD + "f 1 2\n", HEAD + "v 1 2\n",
     HEAD + "v 1 2 nan\n", HEAD + "f a b c\n", HEAD + "v 1 2 3 4\n"],
)  # fmt: skip
def test_a_head_that_cannot_be_is_refused(folder: Path, text: str) -> None:
    (folder / "head.obj").write_text(text)
    with pytest.raises(Failure, match="estimate again"):
        read_head(folder / "head.obj")


def test_every_verdict_has_its_words() -> None:
    for word in get_args(Word):
        assert of_verdict(f"direction {word}, brightness rough, colour sure") != UNKNOWN
    assert of_verdict("unreliable: hardly a face") != UNKNOWN
    assert of_verdict("a new one: of a later version") == UNKNOWN
