"""``skylight export light``: what it writes and what it refuses."""

import json
from pathlib import Path
from typing import get_args

import pytest
import torch

from skylight.app.maps.export_light import LightTarget, default_face
from skylight.cli import main
from skylight.io.files import read_light, write_environment_map
from skylight.sphere.cube_faces import FACES
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.frame import convert_latlong
from skylight.sphere.harmonic_conventions import HarmonicConvention, to_convention
from skylight.sphere.harmonics import project


def test_the_command_offers_what_there_is() -> None:
    command = __import__("skylight.cli.export_light", fromlist=["LightTarget"])
    assert get_args(command.LightTarget) == get_args(LightTarget)
    assert get_args(command.HarmonicConvention) == get_args(HarmonicConvention)


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
