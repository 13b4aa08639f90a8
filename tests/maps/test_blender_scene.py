"""``skylight export blender``: an estimate as a scene of Blender, and what is refused."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from skylight._figures import describe_lamps
from skylight.cli import main
from skylight.faces._observe import SKIN_SPECULAR
from skylight.io._bounded import write_json
from skylight.io._files import read_environment_map, write_environment_map
from skylight.relight._lamps import SUN_RADIUS_RAD as NEAR_RAD, disc_diameter_rad
from skylight.skies._sun import SUN_RADIUS_RAD
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, direction_from_angles
from tests.lamp_lit import lamp_lit, lamp_params

WHITE_BALANCE = torch.tensor([1.25, 1.0, 0.8], dtype=torch.float64)
HEAD = "v 0 0 -1\nv 0.1 0 -1\nv 0 0.1 -1\nf 1 2 3\n"
FACE: dict[str, Any] = {
    "picture_px": [48, 64],
    "focal_length_px": 120.0,
    "albedo": [0.5, 0.4, 0.3],
    "gloss": 2.0,
}
NUMBERS: dict[str, Any] = {
    "light": "autoencoder",
    "lamps": [],
    "white_balance": WHITE_BALANCE.tolist(),
    "verdict": {"summary": "direction rough, brightness rough, colour sure"},
    "advice": ["grey picture"],
}


def sunny() -> EnvironmentMap:
    """A sky that is brighter above, and a sun a degree wide at azimuth 50, zenith 35."""
    grid = DirectionGrid.latlong(64)
    towards = direction_from_angles(*torch.tensor([50.0, 35.0]).deg2rad().double())
    lobe = 900 * torch.exp(4000 * (grid.directions @ towards - 1))
    sky = 0.4 + 0.3 * grid.directions[:, 1:2] * torch.tensor([0.6, 0.8, 1.0])
    radiance = sky + lobe[:, None] * torch.tensor([1.0, 0.9, 0.7])
    return EnvironmentMap(radiance=radiance.reshape(64, 128, 3).float())


@pytest.fixture
def estimate(tmp_path: Path) -> Path:
    """A folder as an estimate leaves it, as far as is exported, and its photograph."""
    folder = tmp_path / "estimate"
    folder.mkdir()
    photo = tmp_path / "photo.png"
    codes = np.random.default_rng(3).integers(0, 256, (64, 48, 3), np.uint8)
    Image.fromarray(codes).save(photo)
    write_environment_map(folder / "probe.exr", sunny())
    (folder / "mesh.obj").write_text(HEAD)
    write_json(folder / "estimate.json", NUMBERS | {"faces": [FACE | {"source": str(photo)}]})
    return folder


def rewrite(folder: Path, face: dict[str, object] | None = None, **changed: object) -> None:
    content = json.loads((folder / "estimate.json").read_text())
    content["faces"][0] |= face or {}
    write_json(folder / "estimate.json", content | changed)


def export(estimate: Path, *options: str) -> tuple[dict[str, Any], EnvironmentMap]:
    out = estimate.parent / "out"
    assert main(["export", "blender", str(estimate), str(out), *options]) == 0
    told = json.loads((out / "blender_scene.json").read_text())
    return told, read_environment_map(out / told["world"], convention="blender")


def test_sun_and_rest_give_what_the_map_does_in_the_photographs_colours(estimate: Path) -> None:
    told, rest = export(estimate)
    (sun,) = told["suns"]
    assert sun["name"] == "sun"
    assert sun["angle_rad"] == pytest.approx(2 * SUN_RADIUS_RAD, rel=1e-4)
    x, y, z = sun["towards"]
    towards = torch.tensor([x, z, -y], dtype=torch.float64)  # of Blender's axes
    expected = direction_from_angles(*torch.tensor([50.0, 35.0]).deg2rad().double())
    assert math.degrees(math.acos(float(towards @ expected))) < 0.5
    irradiance = sun["energy"] * torch.tensor(sun["colour"], dtype=torch.float64)
    assert max(sun["colour"]) == 1
    full, worst = sunny(), 0.0
    for normal in DirectionGrid.hammersley(50).directions:
        lit = irradiance * (normal @ towards).clamp(min=0) + rest.irradiance(normal).double()
        exact = WHITE_BALANCE * full.irradiance(normal).double()
        worst = max(worst, float(((lit - exact).abs() / irradiance).max()))
    assert worst < 0.5 * math.sin(NEAR_RAD)
    assert float(rest.radiance.max()) < 1  # no sun is left in it


def test_the_numbers_are_the_estimates(estimate: Path) -> None:
    told, _ = export(estimate)
    assert told["kind"] == "skylight blender scene"
    assert told["photograph_px"] == [48, 64]
    assert told["focal_length_px"] == 120
    assert told["albedo"] == [0.5, 0.4, 0.3]
    assert told["roughness"] == SKIN_SPECULAR.roughness
    reflectance = ((told["ior"] - 1) / (told["ior"] + 1)) ** 2
    assert reflectance == pytest.approx(2 * SKIN_SPECULAR.f0)
    assert told["verdict"] == "direction rough, brightness rough, colour sure"
    assert told["advice"] == ["grey picture"]
    out = estimate.parent / "out"
    assert (out / told["head"]).read_text() == HEAD
    with Image.open(out / told["photograph"]) as shown, Image.open(out.parent / "photo.png") as was:
        assert np.array_equal(np.array(shown), np.array(was))


def test_the_lights_unit_is_told_where_it_is_known(estimate: Path) -> None:
    assert export(estimate)[0]["cd_per_m2"] is None
    content = json.loads((estimate / "estimate.json").read_text())
    write_json(estimate / "estimate.json", content | {"luminance": {"cd_per_m2": 320.0}})
    assert export(estimate)[0]["cd_per_m2"] == 320


def test_the_photograph_is_upright_and_may_have_moved(estimate: Path) -> None:
    turned = estimate.parent / "elsewhere.png"
    with Image.open(estimate.parent / "photo.png") as image:
        upright = np.array(image)
    exif = Image.Exif()
    exif[0x0112] = 6  # to be turned clockwise by a quarter
    Image.fromarray(np.rot90(upright)).save(turned, exif=exif)
    (estimate.parent / "photo.png").unlink()
    told, _ = export(estimate, "--photo", str(turned))
    with Image.open(estimate.parent / "out" / told["photograph"]) as shown:
        assert np.array_equal(np.array(shown), upright)


def test_a_relative_path_is_found_from_beside_the_estimate(
    estimate: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rewrite(estimate, {"source": "photo.png"})
    export(estimate)
    monkeypatch.chdir(estimate)
    out = estimate.parent / "out"
    assert main(["export", "blender", ".", str(out)]) == 0
    monkeypatch.chdir(estimate.parent)
    (estimate.parent / "estimate").rename(estimate.parent / "moved")
    (estimate.parent / "deeper").mkdir()
    (estimate.parent / "moved").rename(estimate.parent / "deeper" / "moved")
    assert main(["export", "blender", "deeper/moved", str(out)]) == 0


def test_linear_values_are_shown_without_a_tone_map(estimate: Path) -> None:
    """The light is in the photograph's units, where 1 is white, whatever the file is."""
    linear = torch.full((64, 48, 3), 0.2140)
    linear[0, 0] = 3.0
    from skylight.io._files import write_light

    write_light(estimate.parent / "photo.exr", linear, header={})
    told, _ = export(estimate, "--photo", str(estimate.parent / "photo.exr"))
    with Image.open(estimate.parent / "out" / told["photograph"]) as shown:
        assert shown.getpixel((20, 20)) == (127, 127, 127)
        assert shown.getpixel((0, 0)) == (255, 255, 255)


def test_lamps_are_lights_with_their_own_width(estimate: Path) -> None:
    light, lamps = lamp_lit(lamp_params())
    write_environment_map(estimate / "probe.exr", light)
    rewrite(estimate, lamps=describe_lamps(lamps))
    told, rest = export(estimate)
    assert [sun["name"] for sun in told["suns"]] == ["lamp 1", "lamp 2"]
    for sun, lamp in zip(told["suns"], lamps, strict=True):
        assert sun["angle_rad"] == pytest.approx(disc_diameter_rad(lamp.spread_rad), rel=1e-5)
        strength = sun["energy"] * torch.tensor(sun["colour"])
        torch.testing.assert_close(strength.double(), WHITE_BALANCE * lamp.irradiance.double())
    normal = lamps[0].direction
    lit = rest.irradiance(normal) + WHITE_BALANCE * lamps[0].irradiance
    other = float(normal @ lamps[1].direction)
    assert other < 0
    exact = WHITE_BALANCE * light.irradiance(normal)
    torch.testing.assert_close(lit.double(), exact.double(), rtol=0.015, atol=0)


def test_without_a_sun_to_be_seen_all_light_is_the_worlds(estimate: Path) -> None:
    write_environment_map(estimate / "probe.exr", EnvironmentMap(radiance=torch.ones(64, 128, 3)))
    told, rest = export(estimate)
    assert told["suns"] == []
    shown = rest.radiance.double() / WHITE_BALANCE
    torch.testing.assert_close(shown, torch.ones_like(shown), rtol=0.01, atol=0)


def test_a_specular_scale_that_would_reflect_more_than_all_has_an_index_of_refraction(
    estimate: Path,
) -> None:
    rewrite(estimate, {"gloss": 1e6})
    told, _ = export(estimate)
    assert 100 < told["ior"] < 500


def test_of_several_faces_the_first_is_shown(estimate: Path) -> None:
    face = json.loads((estimate / "estimate.json").read_text())["faces"][0]
    rewrite(estimate, faces=[face, face | {"focal_length_px": 99.0}])
    (estimate / "mesh.obj").rename(estimate / "mesh_1.obj")
    told, _ = export(estimate)
    assert told["focal_length_px"] == 120
    assert (estimate.parent / "out" / told["head"]).read_text() == HEAD


@pytest.mark.parametrize(
    ("face", "changed", "message"),
    [
        ({"source": "missing.jpg"}, {}, "missing.jpg: the photograph is not there; say where"),
        ({"source": "a" * 5000}, {}, "the photograph is not there; say where"),
        ({"source": "a\n.jpg"}, {}, "estimate the photograph again"),
        ({"picture_px": [64, 48]}, {}, "48 x 64 pixels, and the estimate is of a photograph of 64"),
        ({"picture_px": None}, {}, "estimate the photograph again"),
        ({"picture_px": [64]}, {}, "estimate the photograph again"),
        ({"picture_px": [10**400, 64]}, {}, "is no number"),
        ({"picture_px": [1e300, 64]}, {}, "estimate the photograph again"),
        ({"focal_length_px": 0}, {}, "estimate the photograph again"),
        ({"focal_length_px": 1e308}, {}, "estimate the photograph again"),
        ({"focal_length_px": "inf"}, {}, "estimate the photograph again"),
        ({"albedo": [0.5, 0.4]}, {}, "estimate the photograph again"),
        ({"albedo": [0.5, 0.4, -1]}, {}, "estimate the photograph again"),
        ({"gloss": -1}, {}, "estimate the photograph again"),
        ({}, {"faces": []}, "not the numbers of a photograph of a face"),
        ({}, {"white_balance": 1}, "estimate the photograph again"),
        ({}, {"white_balance": [1, 1, 1e300]}, "estimate the photograph again"),
        ({}, {"verdict": {}}, "estimate the photograph again"),
    ],
)
def test_what_cannot_be_is_one_line_and_nothing_written(
    estimate: Path,
    capsys: pytest.CaptureFixture[str],
    face: dict[str, object],
    changed: dict[str, object],
    message: str,
) -> None:
    rewrite(estimate, face, **changed)
    out = estimate.parent / "out"
    assert main(["export", "blender", str(estimate), str(out)]) == 2
    line = capsys.readouterr().err
    assert message in line
    assert len(line.splitlines()) == 1
    assert not out.exists()


def test_files_that_are_missing_are_told(
    estimate: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["export", "blender", str(estimate), str(estimate.parent / "out")]
    (estimate / "mesh.obj").unlink()
    assert main(command) == 2
    assert "mesh.obj: there is no such file" in capsys.readouterr().err
    (estimate / "estimate.json").unlink()
    assert main(command) == 2
    assert "a folder that skylight estimate wrote" in capsys.readouterr().err
    assert not (estimate.parent / "out").exists()


def test_radiance_that_no_light_has_is_told(
    estimate: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_environment_map(estimate / "probe.exr", EnvironmentMap(radiance=1e30 * sunny().radiance))
    assert main(["export", "blender", str(estimate), str(estimate.parent / "out")]) == 2
    assert "is no light; estimate again" in capsys.readouterr().err
    assert not (estimate.parent / "out").exists()
