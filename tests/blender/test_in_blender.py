"""The extension in Blender, by its module bpy: installed from its zip, set up, undone, cancelled.

They are skipped where bpy is not installed; docs/blender.md tells how to install it for them.
"""

import importlib.util
import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from skylight.cli import main
from skylight.imaging._colour import linear_to_srgb, srgb_to_linear
from skylight.io._files import read_environment_map
from skylight.skies._sun import SUN_RADIUS_RAD
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid, angle_between, direction_from_angles
from skylight.transport._cameras import Camera
from tests.sunny_face import sunny_face
from tools import build_blender_extension as build

ROOT = Path(__file__).parents[2]
BPY = importlib.util.find_spec("bpy")
pytestmark = pytest.mark.skipif(BPY is None, reason="Blender's module bpy is not installed")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("blender")


@pytest.fixture(scope="module")
def zipped(place: Path) -> Path:
    path = place / "extension.zip"
    build.pack(path)
    return path


@pytest.fixture(scope="module")
def photo(place: Path) -> Path:
    path = place / "portrait.png"
    Image.fromarray(sunny_face(130.0, 50.0).encoded).save(path)
    return path


@pytest.fixture(scope="module")
def estimate(place: Path, photo: Path) -> Path:
    out = place / "estimate"
    assert main(["estimate", str(photo), "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def exported(place: Path, estimate: Path) -> Path:
    out = place / "exported"
    assert main(["export", "blender", str(estimate), str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def program(place: Path) -> Path:
    """skylight as it is here, as an executable."""
    path = place / "skylight"
    path.write_text(f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} -m skylight "$@"\n')
    path.chmod(0o755)
    return path


def blender(check: str, zipped: Path, **asked: Any) -> Any:
    """The answer of that check of in_blender.py."""
    resources = zipped.parent / "resources"
    shutil.rmtree(resources, ignore_errors=True)
    ended = subprocess.run(
        [
            sys.executable,
            str(Path(__file__).with_name("in_blender.py")),
            check,
            json.dumps({"zip": str(zipped)} | asked),
        ],
        env=os.environ | {"BLENDER_USER_RESOURCES": str(resources)},
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    lines = [line for line in ended.stdout.splitlines() if line.startswith("FOUND ")]
    assert lines, ended.stdout[-3000:] + ended.stderr[-3000:]
    assert ended.returncode == 0, ended.stderr[-3000:]
    return json.loads(lines[0].removeprefix("FOUND "))


def grey(path: Path) -> np.ndarray:
    """(h, w) codes of brightness."""
    with Image.open(path) as image:
        return np.asarray(image.convert("L"), float)


def numbers(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "estimate.json").read_text())


def test_blender_itself_finds_the_zip_valid(zipped: Path) -> None:
    assert BPY is not None
    assert BPY.origin is not None
    (command,) = Path(BPY.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")
    ended = subprocess.run(
        [sys.executable, str(command), "validate", str(zipped)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr


@pytest.fixture(scope="module")
def shown(zipped: Path, exported: Path) -> dict[str, Any]:
    return blender("set_up", zipped, folder=str(exported))


def test_the_camera_sees_the_head_where_skylights_does(
    shown: dict[str, Any], estimate: Path, photo: Path
) -> None:
    face = numbers(estimate)["faces"][0]
    with Image.open(photo) as image:
        width, height = image.size
    assert shown["resolution"] == [width, height]
    camera = Camera(
        focal_px=face["focal_length_px"],
        width=width,
        height=height,
        center_px=(width / 2, height / 2),
    )
    vertices = [
        [float(part) for part in line.split()[1:]]
        for line in (estimate / "mesh.obj").read_text().splitlines()
        if line.startswith("v ")
    ]
    expected = camera.project(torch.tensor(vertices, dtype=torch.float64)).numpy()
    off = np.linalg.norm(np.array(shown["pixels"]) - expected, axis=1)
    assert len(off) > 1000
    assert off.max() < 0.01


def test_the_photograph_is_behind_and_the_head_catches_shadows(
    shown: dict[str, Any], exported: Path
) -> None:
    assert Path(shown["photograph"]) == exported / "photograph.png"
    assert shown["photograph_px"] == shown["resolution"]
    assert shown["photograph_colours"] == "sRGB"
    assert shown["photograph_is_shown"]
    assert shown["catches_shadows"]
    assert shown["engine"] == "CYCLES"
    assert shown["film_transparent"]
    assert shown["view"] == "Standard"


def test_the_sun_is_the_estimates(shown: dict[str, Any], estimate: Path, exported: Path) -> None:
    assert Path(shown["world_image"]) == exported / "blender_light.hdr"
    assert shown["world_colours"].startswith("Linear")
    (sun,) = shown["suns"]
    assert sun["angle_rad"] == pytest.approx(2 * SUN_RADIUS_RAD, rel=1e-4)
    x, y, z = sun["towards"]
    towards = torch.tensor([x, z, -y], dtype=torch.float64)
    told = numbers(estimate)["sun"]
    azimuth, zenith = math.radians(told["azimuth_deg"]), math.radians(told["zenith_deg"])
    estimated = direction_from_angles(*torch.tensor([azimuth, zenith]).double())
    assert math.degrees(float(angle_between(towards, estimated))) < 1
    assert (shown["verdict"], shown["advice"]) == (
        numbers(estimate)["verdict"]["summary"],
        "\n".join(numbers(estimate)["advice"]),
    )


def lit_by(estimate: Path) -> EnvironmentMap:
    """The estimate's map in the photograph's colours."""
    probe = read_environment_map(estimate / "probe.exr")
    balance = torch.tensor(numbers(estimate)["white_balance"])
    return EnvironmentMap(radiance=probe.radiance * balance)


def test_planes_are_lit_as_the_probe_lights_them(
    place: Path, zipped: Path, exported: Path, estimate: Path
) -> None:
    """By Cycles, in thirty directions, from the sun and the world together."""
    normals = DirectionGrid.hammersley(30).directions
    seen = blender(
        "irradiance",
        zipped,
        folder=str(exported),
        normals=[[x, -z, y] for x, y, z in normals.tolist()],
        samples=512,
        out=str(place / "plane.exr"),
    )
    light = lit_by(estimate)
    exact = torch.stack([light.irradiance(normal) for normal in normals]).double()
    assert (exact.amax(0) > 4 * exact.amin(0)).all()  # it does tell directions apart
    off = (torch.tensor(seen).double() / exact - 1).abs()
    assert float(off.mean()) < 0.005
    assert float(off.max()) < 0.03


def test_the_head_in_cycles_looks_like_the_photograph(
    place: Path, zipped: Path, exported: Path, photo: Path
) -> None:
    """As bright, of the same colour, bright and dark where it is; only the photo has brows."""
    out = place / "head.exr"
    blender("head_rendered", zipped, folder=str(exported), samples=64, out=str(out))
    rendered = torch.from_numpy(np.load(out.with_suffix(".npy"))).float()
    with Image.open(photo) as image:
        picture = srgb_to_linear(torch.from_numpy(np.array(image)).float() / 255)
    face = (rendered[..., 3] > 0.99) & (picture.amax(-1) < 0.99)
    assert float(face.float().mean()) > 0.2
    shown, seen = rendered[..., :3][face], picture[face]
    torch.testing.assert_close(shown.mean(0), seen.mean(0), rtol=0.1, atol=0)
    both = torch.stack([luminance(shown), luminance(seen)])
    assert float(torch.corrcoef(both)[0, 1]) > 0.8


def test_white_is_as_told_whatever_the_view_was(
    place: Path, zipped: Path, exported: Path, estimate: Path
) -> None:
    """Values of a picture that Blender writes, beside the photograph's: from AgX, a look, gamma."""
    told = torch.tensor(json.loads((exported / "blender_scene.json").read_text())["white"])
    towards_camera = torch.tensor([0.0, 0.0, 1.0])
    exact = 0.8 / math.pi * lit_by(estimate).irradiance(towards_camera)
    torch.testing.assert_close(told, exact, rtol=1e-3, atol=0)
    picked = [0.55, 0.5, 0.4]
    found = blender(
        "colours",
        zipped,
        folder=str(exported),
        samples=1024,
        picked=picked,
        out=str(place / "white.png"),
    )
    assert found["told"] == pytest.approx(told.tolist(), rel=1e-5)
    for linear, codes in ((told, found["first"]), (torch.tensor(picked), found["picked"])):
        shown = linear_to_srgb(linear.clamp(max=1))
        torch.testing.assert_close(torch.tensor(codes), shown, rtol=0, atol=0.015)
    albedo = json.loads((exported / "blender_scene.json").read_text())["albedo"]
    kept = [a * w / p for a, w, p in zip(albedo, told.tolist(), picked, strict=True)]
    assert found["albedo"] == pytest.approx([min(each, 1.0) for each in kept], rel=1e-4)
    assert found["again"] == pytest.approx(told.tolist(), rel=1e-5)


def test_the_panel_sees_each_setting_that_is_not_the_photographs(
    zipped: Path, exported: Path
) -> None:
    found = blender("views", zipped, folder=str(exported))
    names = {"display_device", "view_transform", "look", "exposure", "gamma", "use_curve_mapping"}
    assert names <= set(found) <= names | {"use_white_balance"}
    for name, (first, is_other, then) in found.items():
        assert (first, is_other, then) == (True, True, False), name


def test_a_scene_of_an_older_extension_is_to_be_set_up_again(zipped: Path, exported: Path) -> None:
    """Of 0.1.1: no white was noted, nor the suns' own light, and the world cannot follow."""
    found = blender("older", zipped, folder=str(exported), picked=[0.5, 0.5, 0.5])
    assert "white" in found["new"]["drawn"]
    for name in ("older", "older_picked"):
        assert found[name]["irradiance"] == found["new"]["irradiance"], name
        assert "white" not in found[name]["drawn"]
        assert any("set it up again" in line for line in found[name]["drawn"])
    assert found["again"] == found["new"]
    lamps = found["again_twice"]["irradiance"]
    assert lamps.pop("added") == [3.0] * 3  # has no light of the set-up: as it was
    twice = {name: [2 * x for x in sun] for name, sun in found["again"]["irradiance"].items()}
    assert set(lamps) == set(twice) != set()
    for name, sun in twice.items():
        assert lamps[name] == pytest.approx(sun, rel=1e-5)


# all or nothing


def damaged(exported: Path, out: Path) -> dict[str, Path]:
    """Copies of a scene, each with one fault, by what is told of it."""
    folders = {
        "Blender cannot read it": out / "hdr",
        "not the size that the scene says": out / "size",
        "no whole mesh": out / "head",
        "version 9": out / "version",
        "cannot be read": out / "missing",
    }
    for folder in folders.values():
        shutil.copytree(exported, folder)
    (out / "hdr" / "blender_light.hdr").write_bytes(b"no picture")
    Image.new("RGB", (20, 20)).save(out / "size" / "photograph.png")
    (out / "head" / "head.obj").write_text("v 0 0 0\n")
    told = json.loads((exported / "blender_scene.json").read_text())
    (out / "version" / "blender_scene.json").write_text(json.dumps(told | {"version": 9}))
    (out / "missing" / "blender_scene.json").unlink()
    return folders


@pytest.mark.parametrize("is_first", [True, False])
def test_what_cannot_be_set_up_changes_nothing(
    tmp_path: Path, zipped: Path, exported: Path, is_first: bool
) -> None:
    folders = damaged(exported, tmp_path)
    found = blender(
        "refusals",
        zipped,
        first="" if is_first else str(exported),
        folders=[str(folder) for folder in folders.values()],
    )
    for message, told in zip(folders, found, strict=True):
        assert message in told["panel"]
        assert told["panel"] in told["error"]
        assert "\n" not in told["panel"]
        assert told["is_unchanged"], message


def test_without_cycles_nothing_is_set_up(zipped: Path, exported: Path) -> None:
    told = blender("without_cycles", zipped, folder=str(exported))
    assert "Switch on the add-on Cycles" in told["panel"]
    assert told["is_unchanged"]


def test_what_is_broken_off_changes_nothing(zipped: Path, exported: Path) -> None:
    assert blender("broken_off", zipped, folder=str(exported)) == {"is_unchanged": True}


def test_a_second_one_takes_the_place_of_the_first(zipped: Path, exported: Path) -> None:
    found = blender("again", zipped, folder=str(exported))
    assert found == {"is_same": True, "hat_is_there": True, "heads": 1}


def test_it_is_undone_and_done_again(zipped: Path, exported: Path) -> None:
    found = blender("undo", zipped, folder=str(exported))
    assert found == {"changed": True, "undone": True, "redone": True}


# runs of skylight


def test_photographs_become_scenes_or_a_line(
    tmp_path: Path, zipped: Path, photo: Path, estimate: Path, program: Path
) -> None:
    hills = tmp_path / "hills.png"
    Image.fromarray(np.tile(np.arange(200, dtype=np.uint8)[:, None, None], (1, 200, 3))).save(hills)
    other = tmp_path / "other"
    other.write_text("#!/bin/sh\necho skylight 0.7.1\n")
    other.chmod(0o755)
    mine, out = str(program), tmp_path / "out"
    runs = [
        {"program": str(tmp_path / "no" / "skylight"), "photo": str(photo)},
        {"program": str(other), "photo": str(photo), "out": str(out)},
        {"program": mine},
        {"program": mine, "photo": str(tmp_path / "missing.png")},
        {"program": mine, "photo": str(hills), "out": str(out)},
        {"program": mine, "photo": str(photo), "out": str(out), "cancel_at": "tracing light"},
        {"program": mine, "estimate": str(tmp_path)},
        {"program": mine, "estimate": str(estimate)},
        {"program": mine, "photo": str(photo), "out": str(out), "light": "lamps"},
        {"program": mine, "key": "left", "size_deg": 30.0, "editor": True},
        {"program": mine, "key": "rim", "size_deg": 5.0},
        {"program": str(other), "key": "rim", "size_deg": 5.0},
    ]
    expected = [
        "there is no such program: set the path in the preferences",
        "skylight 0.7.1: this extension needs skylight 0.3 to below 0.4",
        "Choose a photo first",
        "there is no such photo",
        "no face",
        "Cancelled.",
        "not the folder of an estimate",
        "",
        "",
        "relit_left.png is there: choose it in an Image Editor",
        "",
        "skylight 0.7.1",
    ]
    found = blender("runs", zipped, runs=runs)
    for run, line, told in zip(runs, expected, found, strict=True):
        assert line in told["panel"]
        assert "\n" not in told["panel"]
        if "key" not in run:
            assert (told["panel"] == "") == (line == "")
            assert told["is_unchanged"] == (line != "")
    assert found[7]["verdict"] == numbers(estimate)["verdict"]["summary"]
    stages = found[8]["stages"]
    wanted = ["finding the face", "tracing light", "estimating the light", "exporting to Blender"]
    assert [stage for stage in stages if stage in wanted] == wanted
    left, rim = out / "relit_left.png", out / "relit_rim.png"
    before, lit, edged = (grey(path) for path in (photo, left, rim))
    assert found[9]["images"][left.name] == found[10]["images"][rim.name] == [*before.shape[::-1]]
    person = np.abs(before - before[0, 0]) > 6  # before a wall of one grey
    on_left = np.indices(person.shape)[1] < np.nonzero(person)[1].mean()
    assert before[person & on_left].mean() < 0.8 * before[person & ~on_left].mean()
    assert lit[person & on_left].mean() > 1.02 * lit[person & ~on_left].mean()
    more = edged - before
    assert more[person].mean() < 0  # the face is in shade before a bright outline on the right
    outline = [more[row, : np.nonzero(person[row])[0].max() + 1][-3:] for row in range(80, 180)]
    assert np.mean(outline) > 20
    assert (found[9]["shown"], found[10]["shown"]) == ([], [rim.name])
    assert found[11]["is_unchanged"]
    # of the run that was cancelled nothing is left but what the last one made
    assert not [path.name for path in out.iterdir() if path.name.startswith(".")]


def test_a_picture_that_cannot_be_read_is_named(tmp_path: Path, zipped: Path) -> None:
    """Of programs that write none, write text, write a picture, and write text over that."""
    (tmp_path / "estimate.json").write_text("{}")
    relit = tmp_path / "relit_top.png"
    picture = tmp_path / "picture.png"
    Image.new("RGB", (6, 4)).save(picture)
    programs = []
    for name, does in (
        ("none", "true"),
        ("text", f"echo no picture > {relit}"),
        ("good", f"cp {picture} {relit}"),
        ("over", f"echo no picture > {relit}"),
        ("gone", f"rm -f {relit}"),
    ):
        program = tmp_path / name
        program.write_text(f"#!/bin/sh\necho skylight 0.3.0\n[ $1 = --version ] || {does}\n")
        program.chmod(0o755)
        programs.append(str(program))
    found = blender("pictures", zipped, estimate=str(tmp_path), programs=programs)
    line = f"{relit}: Blender cannot read it: relight the portrait again"
    shown = "relit_top.png is there: choose it in an Image Editor"
    assert found == [line, line, shown, line, line]


def test_nothing_goes_on_behind_blenders_back(zipped: Path, photo: Path, program: Path) -> None:
    found = blender("left_behind", zipped, photo=str(photo), program=str(program))
    assert found == {"ends": [[True, True, True]] * 2, "is_gone": True}


def test_panels_are_drawn(zipped: Path, photo: Path, program: Path) -> None:
    assert blender("drawn", zipped, photo=str(photo), program=str(program)) == "drawn"
