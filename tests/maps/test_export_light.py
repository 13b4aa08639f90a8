"""``skylight export light``: what it writes and what it refuses."""

import ast
import json
import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import get_args

import pytest
import torch

from skylight._figures import describe_lamps
from skylight._names import LightTarget
from skylight.cli import main
from skylight.io._bounded import write_json
from skylight.io._exr import white_luminance
from skylight.io._files import read_environment_map, read_light, write_environment_map
from skylight.maps._estimated import read_light as read_given
from skylight.maps._export import default_face
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import angle_between, convert_latlong, direction_from_angles
from skylight.sphere._harmonics import project, to_convention
from skylight.sphere._projections import FACES
from tests.lamp_lit import lamp_lit, lamp_params
from tests.relight.test_light_files import read_glb


def test_all_targets_at_once(probe: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = probe.parent / "out"
    targets = get_args(LightTarget)
    assert main(["export", "light", str(probe), str(out), "--as", *targets]) == 0
    written = sorted(path.name for path in out.iterdir())
    assert written == sorted(
        ["lightprobe.json", "threejs_light.hdr", "sh27.json", "ar_light.json", "light.glb",
         "light.usda", "usd_light.exr", "scene.xml", "mitsuba_light.exr", "load_light.py",
         "blender_light.hdr", *[f"cube_{name}.hdr" for name in FACES]]
    )  # fmt: skip
    told = capsys.readouterr()
    assert all(name in told.out for name in written)
    assert "reflections of light.glb lack" in told.err  # a sun of 500


def test_light_whose_sums_are_beyond_float32_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of every target, as files of light hold float32; and nothing is written."""
    radiance = torch.ones(16, 32, 3)
    radiance[3, 4] = 3e38
    probe, out = tmp_path / "bright.exr", tmp_path / "out"
    write_environment_map(probe, EnvironmentMap(radiance=radiance))
    for target in get_args(LightTarget):
        assert main(["export", "light", str(probe), str(out), "--as", target]) == 2
        assert "whose sums no other program holds" in capsys.readouterr().err
    assert not out.exists()


def test_a_probe_of_another_convention_is_turned_first(probe: Path) -> None:
    turned = convert_latlong(read_light(probe), "skylight", "unity")
    write_environment_map(probe.parent / "unity.exr", EnvironmentMap(radiance=turned))
    out = probe.parent / "out"
    options = ["--as", "sh", "--from-convention", "unity", "--sh-convention", "arcore"]
    assert main(["export", "light", str(probe.parent / "unity.exr"), str(out), *options]) == 0
    told = json.loads((out / "sh27.json").read_text(encoding="utf-8"))
    light = EnvironmentMap(radiance=read_light(probe))
    expected = to_convention(project(light.flat.double(), light.grid, 2), "arcore")
    torch.testing.assert_close(torch.tensor(told["sh"]).double(), expected, rtol=1e-5, atol=1e-5)


def test_a_sky_gets_a_dark_half(tmp_path: Path) -> None:
    write_environment_map(tmp_path / "sky.exr", EnvironmentMap(radiance=torch.ones(8, 32, 3)))
    assert main(["export", "light", str(tmp_path / "sky.exr"), str(tmp_path), "--as", "usd"]) == 0
    picture = read_light(tmp_path / "usd_light.exr")
    assert picture.shape == (16, 32, 3)
    assert picture[8:].max() == 0


def test_faces_are_as_large_as_the_map_asks() -> None:
    for rows, face in ((16, 64), (128, 64), (512, 256), (2048, 512)):
        assert default_face(EnvironmentMap(radiance=torch.zeros(rows, 2 * rows, 3))) == face


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--as", "ar", "--face", "100"], "power of two from 32 to 2048"),
        (["--as", "gltf", "--face", "16"], "power of two from 32 to 2048"),
    ],
)
def test_what_cannot_be_is_told_and_nothing_written(
    probe: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    out = probe.parent / "out"
    assert main(["export", "light", str(probe), str(out), *options]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_a_file_that_is_no_map_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    missing = str(tmp_path / "missing.exr")
    assert main(["export", "light", missing, str(tmp_path / "out"), "--as", "usd"]) == 2
    assert "there is no such file" in capsys.readouterr().err


# the lamps of any map


@pytest.fixture
def sunny(tmp_path: Path) -> Path:
    """A map with a sun of irradiance 9 at azimuth 50, zenith 40 in an even sky."""
    towards = direction_from_angles(*torch.tensor([50.0, 40.0]).deg2rad().double())
    sky = EnvironmentMap(radiance=torch.full((64, 128, 3), 0.5))
    lit = sky.with_light(towards, torch.tensor([9.0, 8.0, 7.0]))
    write_environment_map(tmp_path / "sunny.exr", lit)
    return tmp_path / "sunny.exr"


def test_a_maps_sun_becomes_a_light_of_each_program(
    sunny: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = sunny.parent / "out"
    command = ["export", "light", str(sunny), str(out), "--lamps", "2"]
    assert main([*command, "--as", "mitsuba", "threejs", "usd", "gltf", "ar"]) == 0
    told = capsys.readouterr()
    assert "not in the map: 1" in told.out
    assert "azimuth 50.0, zenith 40.0 degrees, 0.53 degrees wide, irradiance 9" in told.out
    emitter = ElementTree.parse(out / "scene.xml").getroot().find("emitter[@type='directional']")
    assert emitter is not None
    assert "irradiance" in ElementTree.tostring(emitter, encoding="unicode")
    for name, convention in (
        ("mitsuba_light.exr", "mitsuba"),
        ("usd_light.exr", "openexr"),
        ("threejs_light.hdr", "threejs"),
    ):
        rest = read_environment_map(out / name, convention=convention)
        torch.testing.assert_close(rest.radiance, torch.full((64, 128, 3), 0.5), rtol=5e-3, atol=0)
    assert "DistantLight" in (out / "light.usda").read_text(encoding="utf-8")
    probe = json.loads((out / "lightprobe.json").read_text(encoding="utf-8"))
    assert [child["type"] for child in probe["object"]["children"]][1:] == ["DirectionalLight"]
    assert json.loads((out / "ar_light.json").read_text(encoding="utf-8"))  # all light


@pytest.mark.parametrize("convention", ["skylight", "blender"])
def test_blender_gets_a_sun_that_stands_where_the_map_shows_it(
    sunny: Path, convention: str
) -> None:
    out = sunny.parent / "out"
    source = sunny.parent / "turned.exr"
    write_environment_map(source, read_environment_map(sunny), convention=convention)
    command = ["export", "blender", str(source), str(out), "--from-convention", convention]
    assert main(command) == 0
    script = (out / "load_light.py").read_text(encoding="utf-8")
    ((name, towards, colour, energy, angle),) = ast.literal_eval(
        script[script.index("LAMPS = [") + 8 : script.index("]\nfor name")] + "]"
    )
    assert name == "lamp 1"
    x, y, z = towards
    expected = direction_from_angles(*torch.tensor([50.0, 40.0]).deg2rad().double())
    seen = torch.tensor([x, z, -y], dtype=torch.float64)
    assert math.degrees(float(angle_between(seen, expected))) < 0.5
    torch.testing.assert_close(
        energy * torch.tensor(colour), torch.tensor([9.0, 8.0, 7.0]), rtol=0.01, atol=0
    )
    assert math.degrees(angle) == pytest.approx(0.533, abs=0.01)
    rest = read_environment_map(out / "blender_light.hdr", convention="blender")
    assert float(rest.radiance.max()) < 0.51


def test_what_lamps_cannot_be_taken_is_told(
    sunny: Path, estimate: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(sunny.parent / "out")
    for command, message in (
        (["light", str(sunny), out, "--as", "usd", "--lamps", "-1"], "0 to 8 lamps"),
        (["light", str(estimate), out, "--as", "usd", "--lamps", "1"], "leave --lamps out"),
        (["blender", str(estimate), out, "--lamps", "1"], "are of maps"),
        (["blender", str(sunny), out, "--photo", "me.jpg"], "leave --photo out"),
    ):
        assert main(["export", *command]) == 2
        assert message in capsys.readouterr().err
    even = sunny.parent / "even.exr"
    write_environment_map(even, EnvironmentMap(radiance=torch.ones(16, 32, 3)))
    assert main(["export", "blender", str(even), out]) == 0
    assert "no compact light in the map: it is whole" in capsys.readouterr().out


# estimates


@pytest.fixture
def estimate(tmp_path: Path) -> Path:
    """A folder with what an estimate writes of its light: two lamps, the map and the numbers."""
    light, lamps = lamp_lit(lamp_params())
    folder = tmp_path / "estimate"
    folder.mkdir()
    write_environment_map(folder / "probe.exr", light)
    content = {"light": "lamps", "lamps": describe_lamps(lamps)}
    write_json(folder / "estimate.json", content)
    return folder


@pytest.mark.parametrize("is_map", [True, False])
def test_the_unit_in_candela_goes_into_every_file(estimate: Path, is_map: bool) -> None:
    given = estimate
    if is_map:
        given = estimate.parent / "map.exr"
        light = read_environment_map(estimate / "probe.exr")
        write_environment_map(given, light, header={"whiteLuminance": 250.0})
    else:
        rewrite(estimate, luminance={"cd_per_m2": 250.0, "uncertainty_stops": 1})
    out = estimate.parent / "out"
    assert main(["export", "light", str(given), str(out), "--as", *get_args(LightTarget)]) == 0
    for name in ("sh27.json", "ar_light.json"):
        assert json.loads((out / name).read_text(encoding="utf-8"))["cd_per_m2"] == 250
    three = json.loads((out / "lightprobe.json").read_text(encoding="utf-8"))
    assert three["object"]["userData"] == {"cd_per_m2": 250}
    tree, _ = read_glb(out / "light.glb")
    assert tree["asset"]["extras"] == {"cd_per_m2": 250}
    assert "double cd_per_m2 = 250\n" in (out / "light.usda").read_text(encoding="utf-8")
    for name in ("usd_light.exr", "mitsuba_light.exr"):
        assert white_luminance(out / name) == 250
    assert 'world["cd_per_m2"] = 250 ' in (out / "load_light.py").read_text(encoding="utf-8")
    ast.parse((out / "load_light.py").read_text(encoding="utf-8"))


def test_an_unknown_unit_is_none(estimate: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = estimate.parent / "out"
    command = ["export", "light", str(estimate), str(out), "--as", "sh", "usd", "blender"]
    assert main(command) == 0
    assert json.loads((out / "sh27.json").read_text(encoding="utf-8"))["cd_per_m2"] is None
    assert white_luminance(out / "usd_light.exr") is None
    assert "UNIT" not in (out / "light.usda").read_text(encoding="utf-8")
    assert "cd_per_m2" not in (out / "load_light.py").read_text(encoding="utf-8")
    for wrong in ({"cd_per_m2": -1.0}, {"cd_per_m2": "bright"}, {}):
        rewrite(estimate, luminance=wrong)
        assert main(command) == 2
        assert "estimate the photograph again" in capsys.readouterr().err


def rewrite(folder: Path, **changed: object) -> None:
    content = json.loads((folder / "estimate.json").read_text(encoding="utf-8"))
    write_json(folder / "estimate.json", content | changed)


def test_an_estimates_lamps_become_lights_and_leave_the_map(
    estimate: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = estimate.parent / "out"
    targets = ["--as", "mitsuba", "sh"]
    assert main(["export", "light", str(estimate), str(out), *targets]) == 0
    assert "not in the map: 2" in capsys.readouterr().out
    light, lamps = lamp_lit(lamp_params())
    scene = ElementTree.parse(out / "scene.xml").getroot()
    emitters = scene.findall("emitter[@type='directional']")
    for emitter, lamp in zip(emitters, lamps, strict=True):
        vector = emitter.find("vector")
        assert vector is not None
        along = [float(vector.attrib[axis]) for axis in "xyz"]
        assert along == pytest.approx((-lamp.direction).tolist(), abs=1e-6)
    rest = read_environment_map(out / "mitsuba_light.exr", convention="mitsuba")
    received = rest.irradiance(lamps[0].direction) + lamps[0].irradiance
    torch.testing.assert_close(received, light.irradiance(lamps[0].direction), rtol=0.01, atol=0)
    # harmonics alone, and ARCore's light with its own sun, are of all light
    told = json.loads((out / "sh27.json").read_text(encoding="utf-8"))
    whole = project(light.flat.double(), light.grid, 2)
    found = torch.tensor(told["sh"]).double().reshape(9, 3)
    torch.testing.assert_close(found, whole, rtol=1e-4, atol=1e-4)


def test_all_light_in_one_has_no_lamps_to_tell_of(
    estimate: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "light", str(estimate), str(estimate.parent), "--as", "sh"]) == 0
    assert "lamps" not in capsys.readouterr().out


def test_an_estimate_is_given_by_its_folder_or_its_numbers(estimate: Path) -> None:
    light, lamps = read_given(estimate, "skylight")
    again, same = read_given(estimate / "estimate.json", "skylight")
    assert torch.equal(light.radiance, again.radiance)
    assert describe_lamps(lamps) == describe_lamps(same)
    assert len(lamps) == 2


@pytest.mark.parametrize(
    "content", [{"light": "sh9", "lamps": []}, {"light": "vmf"}], ids=["of a face", "of an object"]
)
def test_an_estimate_without_lamps_is_its_map(estimate: Path, content: dict[str, object]) -> None:
    write_json(estimate / "estimate.json", content)
    light, lamps = read_given(estimate, "skylight")
    assert lamps == ()
    assert torch.equal(light.radiance, read_given(estimate / "probe.exr", "skylight")[0].radiance)


GOOD = {"azimuth_deg": 10.0, "zenith_deg": 40.0, "irradiance": [1, 1, 1], "spread_deg": 8.0}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"lamps": 3}, '"lamps" must be a list, got a int'),
        ({"lamps": [GOOD, 3]}, "lamp 2 needs azimuth_deg"),
        ({"lamps": [GOOD | {"irradiance": [1, 1]}]}, "lamp 1 needs azimuth_deg"),
        ({"lamps": [GOOD | {"irradiance": [1, 1, -1]}]}, "irradiance of 0 or more"),
        ({"lamps": [GOOD | {"spread_deg": 0}]}, "a spread of 0.01 to 42.0 degrees"),
        ({"lamps": [GOOD | {"spread_deg": "wide"}]}, "lamp 1 needs azimuth_deg"),
        ({"lamps": [GOOD | {"irradiance": [99, 99, 99]}]}, "does not hold the light"),
    ],
)
def test_a_list_of_lamps_that_cannot_be_is_told(
    estimate: Path, capsys: pytest.CaptureFixture[str], changed: dict[str, object], message: str
) -> None:
    rewrite(estimate, **changed)
    out = estimate.parent / "out"
    assert main(["export", "light", str(estimate), str(out), "--as", "usd"]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_what_is_no_estimate_is_told(estimate: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["export", "light", str(estimate), str(estimate.parent / "out"), "--as", "usd"]
    assert main([*command, "--from-convention", "blender"]) == 2
    assert "leave --from-convention out" in capsys.readouterr().err
    (estimate / "estimate.json").write_text("[1]")
    assert main(command) == 2
    assert '"light" is missing' in capsys.readouterr().err
    (estimate / "estimate.json").write_text("{")
    assert main(command) == 2
    assert "not JSON" in capsys.readouterr().err
    write_json(estimate / "estimate.json", {"light": "sh9"})
    (estimate / "probe.exr").unlink()
    assert main(command) == 2
    assert "probe.exr: there is no such file" in capsys.readouterr().err
    (estimate / "estimate.json").unlink()
    assert main(command) == 2
    assert "a folder that skylight estimate wrote" in capsys.readouterr().err
