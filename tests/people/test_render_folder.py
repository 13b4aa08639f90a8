"""Folders of faces: whole, resumed, reproducible, and read as they were written."""

import importlib
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import torch

pytest.importorskip("mitsuba", reason="mitsuba is not installed")

from skylight.cli import main
from skylight.errors import InputError, OutputError
from skylight.evaluation._known_faces import read_face
from skylight.faces._fit import camera_project
from skylight.faces._model import HeadModel
from skylight.io._files import write_environment_map
from skylight.people import _files as batch, _light as light_module
from skylight.people._background import BackgroundKind
from skylight.people._files import (
    read_rendered_face,
    read_scene_facts,
    render_folder,
    rendered_faces,
)
from skylight.people._light import Backgrounds, RenderOptions, Skies, scene_light
from skylight.people._maps import MapFolder, TurnedMap
from skylight.people._people import person
from skylight.skies._simulated import EVALUATION_SEEDS
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import angle_between

TINY = RenderOptions(size=40, samples=4, seed=1, per_scene=2, hair=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("faces")
    assert render_folder(out, 2, TINY) == 2
    return out


def test_faces_of_a_scene_share_light_and_exposure_and_nothing_else(folder: Path) -> None:
    first, second = (read_rendered_face(face) for face in rendered_faces(folder))
    assert torch.equal(first.environment.radiance, second.environment.radiance)
    assert first.exposure == second.exposure
    assert (first.scene, second.scene) == (0, 0)
    assert (first.number, second.number) == (0, 1)
    assert (first.cluster, second.cluster) == (0, 1)
    assert first.truth.camera == second.truth.camera
    assert np.abs(first.truth.identity - second.truth.identity).max() > 0.1
    assert np.abs(first.truth.rotation - second.truth.rotation).max() > 0.01
    assert first.albedo.mean() > second.albedo.mean()


def test_the_truth_fits_together(folder: Path) -> None:
    face = read_rendered_face(rendered_faces(folder)[0])
    model, truth = HeadModel.load(), face.truth
    shape = model.vertices(truth.identity, truth.expression)
    np.testing.assert_allclose(truth.vertices, shape @ truth.rotation.T + truth.translation)
    points = camera_project(truth.camera, model.landmarks(truth.vertices))
    np.testing.assert_allclose(face.landmarks[17:], points[17:], atol=1e-6)
    assert face.environment.layout == (64, 128)
    assert face.turned_map is face.turbidity is None
    assert face.sky_seed is not None
    assert face.sun_direction is not None
    brightest = face.environment.brightest_direction()
    assert float(torch.rad2deg(angle_between(face.sun_direction, brightest))) < 4
    assert face.sky_seed >= EVALUATION_SEEDS
    # the light below the horizon is the ground's bounce of that above
    sky = face.environment.upper().with_ground(torch.zeros(3))
    bounce = face.ground_albedo / np.pi * sky.irradiance(torch.tensor([0.0, 1.0, 0.0]))
    # a sum over pixel centres against exact integrals
    torch.testing.assert_close(face.environment.radiance[-1, 0], bounce, rtol=0.02, atol=0)
    # the picture is the linear one, give or take noise, codes and clipping
    seen = face.linear.clamp(0, 1)
    assert float((seen - face.picture).abs().median()) < 0.02
    assert 0.02 < face.hair.mean() < 0.4


def test_a_lamp_to_one_side_lights_that_side(tmp_path: Path) -> None:
    """Under a map that is turned so that its lamp, straight ahead, goes where the facts say."""
    maps = tmp_path / "maps"
    maps.mkdir()
    radiance = torch.full((64, 128, 3), 0.02)
    radiance[28:32, 62:66] = 100.0
    write_environment_map(maps / "lamp.exr", EnvironmentMap(radiance=radiance))
    options = RenderOptions(size=40, samples=4, maps=MapFolder.read(maps))
    out = tmp_path / "faces"
    assert render_folder(out, 1, options) == 1
    assert render_folder(out, 1, options) == 0
    face = read_rendered_face(out / "face0000")
    turned = face.turned_map
    assert turned == TurnedMap(file="lamp.exr", category=None, turn_deg=turned.turn_deg)
    assert face.sky_seed is face.sun_transmittance is face.sun_direction is None
    assert face.ground_albedo is None
    assert not read_face(out / "face0000").sun_visible
    azimuth = np.radians(turned.turn_deg)
    lamp = face.environment.brightest_direction().double()
    there = torch.tensor([np.sin(azimuth), 0.0, -np.cos(azimuth)])
    assert float(torch.rad2deg(angle_between(lamp, there))) < 10  # it stands 8 degrees high
    # whichever side that is, skin on it is brighter
    assert abs(np.sin(azimuth)) > 0.3
    columns = face.linear[10:30, :].mean((0, 2))
    right, left = float(columns[21:28].mean()), float(columns[12:19].mean())
    assert (right > 1.2 * left) if np.sin(azimuth) > 0 else (left > 1.2 * right)


def test_a_face_under_a_sky_of_hosek_and_wilkie(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(light_module, "_FINER", 1)
    options = RenderOptions(size=40, samples=4, skies="hosek-wilkie")
    out = tmp_path / "faces"
    assert render_folder(out, 1, options) == 1
    face = read_rendered_face(out / "face0000")
    assert face.turbidity is not None
    assert 2 <= face.turbidity <= 8
    assert face.sky_seed is face.turned_map is None
    assert face.sun_direction is not None
    assert face.ground_albedo is not None
    brightest = face.environment.brightest_direction()
    assert float(torch.rad2deg(angle_between(face.sun_direction, brightest))) < 0.5
    assert read_face(out / "face0000").sun_visible
    with pytest.raises(InputError, match="another folder"):
        render_folder(out, 1, RenderOptions(size=40, samples=4))


def test_the_same_people_in_the_light_of_another_seed() -> None:
    options = RenderOptions(size=32, seed=3)
    other = replace(options, light_seed=4)
    here, there = scene_light(1, options), scene_light(1, other)
    assert there.focal == here.focal
    assert there.sky_seed == scene_light(1, RenderOptions(size=32, seed=4)).sky_seed
    assert there.sky_seed != here.sky_seed
    np.testing.assert_array_equal(
        person(1, there.focal, other).points, person(1, here.focal, options).points
    )
    assert "light_seed" not in options.settings()
    assert other.settings()["light_seed"] == 4


def test_faces_from_before_there_were_maps_are_read(folder: Path, tmp_path: Path) -> None:
    face = shutil.copytree(folder / "face0000", tmp_path / "face0000")
    facts = json.loads((face / "face.json").read_text())
    for name in ("map", "category", "turn_deg", "turbidity"):
        assert facts.pop(name) is None
    assert facts.pop("background")["kind"] in get_args(BackgroundKind)
    (face / "face.json").write_text(json.dumps(facts))
    assert read_rendered_face(face).turned_map is None
    assert read_rendered_face(face).background is None


def test_before_one_background_and_another_the_face_is_the_same(
    folder: Path, tmp_path: Path
) -> None:
    """But for what a wall adds to the light; only noise of the camera is drawn anew."""
    first = read_rendered_face(folder / "face0000")
    options = replace(TINY, backgrounds="infinite")
    assert "backgrounds" not in options.settings()
    assert render_folder(tmp_path, 1, options) == 1
    plain = read_rendered_face(tmp_path / "face0000")
    assert plain.background is None
    assert first.background is not None
    np.testing.assert_array_equal(first.truth.vertices, plain.truth.vertices)
    assert first.background.kind not in ("wall", "backdrop", "screen")  # by this seed
    torch.testing.assert_close(first.environment.radiance, plain.environment.radiance)
    face = slice(15, 25)
    torch.testing.assert_close(
        first.linear[face, face], plain.linear[face, face], rtol=1e-3, atol=1e-4
    )


def test_a_second_run_makes_only_what_is_missing_and_the_same(folder: Path, tmp_path: Path) -> None:
    assert render_folder(folder, 2, TINY) == 0
    reports: list[tuple[int, int]] = []
    other = tmp_path / "other"
    other.mkdir()
    (other / "face0000").mkdir()  # there, as far as a run can tell
    made = render_folder(other, 2, TINY, progress=lambda *state: reports.append(state))
    assert (made, reports) == (1, [(1, 2), (2, 2)])
    first, again = (read_rendered_face(d / "face0001") for d in (folder, other))
    differ = np.abs(first.encoded.astype(int) - again.encoded)
    assert differ.max() <= 1  # the order of float sums may differ
    assert (differ > 0).mean() < 0.001
    assert not list(other.glob(".partial-*"))


def test_a_face_that_is_there_meanwhile_stays(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker that is taken for lost may have put it there."""
    there = shutil.copytree(folder / "face0001", tmp_path / "face0001")
    monkeypatch.setattr(batch, "write_rendered_face", lambda place, *_: (place / "x").touch())
    monkeypatch.setattr(batch, "render", lambda *_: None)
    batch.render_to(tmp_path, 1, TINY)
    assert list(tmp_path.iterdir()) == [there]
    assert {file.name for file in there.iterdir()} == {
        file.name for file in (folder / "face0001").iterdir()
    }
    shutil.rmtree(there)
    there.touch()  # no folder: not what a worker leaves
    with pytest.raises(OutputError, match="cannot write"):
        batch.render_to(tmp_path, 1, TINY)


def test_other_options_want_another_folder(folder: Path) -> None:
    with pytest.raises(InputError, match="another folder"):
        render_folder(folder, 2, RenderOptions(size=40, samples=5))


def test_a_face_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(batch, "write_rendered_face", fail)
    monkeypatch.setattr(batch, "render", lambda *_: None)
    with pytest.raises(KeyboardInterrupt):
        render_folder(tmp_path, 1, TINY)
    assert {file.name for file in tmp_path.iterdir()} == {".lock", "options.json"}


def test_folders_without_faces_or_with_damaged_ones_are_named(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no rendered faces"):
        rendered_faces(tmp_path)
    face = tmp_path / "face0000"
    face.mkdir()
    facts = json.loads((folder / "face0000" / "face.json").read_text())
    del facts["albedo"]
    (face / "face.json").write_text(json.dumps(facts))
    with pytest.raises(InputError, match="face0000"):
        read_rendered_face(face)
    for damaged in ({"kind": "sea", "depth_m": 1, "blur_px": 2}, {"kind": "wall"}, [3], "wall"):
        (face / "face.json").write_text(json.dumps({"background": damaged}))
        with pytest.raises(InputError, match="face0000: no facts of a rendered face"):
            read_scene_facts(face)


@pytest.mark.parametrize("kept", [0, 1000])
def test_a_damaged_mesh_is_named(folder: Path, tmp_path: Path, kept: int) -> None:
    face = shutil.copytree(folder / "face0000", tmp_path / "face0000")
    whole = (face / "mesh.npz").read_bytes()
    (face / "mesh.npz").write_bytes(whole[:kept])
    with pytest.raises(InputError, match="face0000"):
        read_rendered_face(face)


def test_the_command_renders_and_refuses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "faces")
    # the module's options, whose day is already found
    options = ["--size", "40", "--samples", "4", "--seed", "1", "--per-scene", "2", "--hair"]
    options += ["--workers", "1"]
    assert main(["faces", "render", "--count", "1", "--out", out, *options]) == 0
    assert "1 faces, 1 of them rendered now" in capsys.readouterr().out
    assert main(["faces", "render", "--count", "0", "--out", out]) == 2
    assert "--count must be 1 or more" in capsys.readouterr().err
    other = ["faces", "render", "--out", out, "--skies", "hosek-wilkie"]
    assert main([*other, "--sunny"]) == 2
    assert "leave it out with --skies hosek-wilkie" in capsys.readouterr().err
    assert main([*other, "--maps", str(tmp_path)]) == 2
    assert "leave out --skies hosek-wilkie" in capsys.readouterr().err


def test_the_commands_skies_are_the_options() -> None:
    command = importlib.import_module("skylight.people._command")
    assert (command.Skies, command.Backgrounds) == (Skies, Backgrounds)
