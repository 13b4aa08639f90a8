"""Maps of light converted by the command, and what it refuses."""

import math
from pathlib import Path
from typing import get_args

import numpy as np
import OpenEXR
import pytest
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from skylight._names import Convention, MapLayout
from skylight.cli import main
from skylight.imaging._preview import preview
from skylight.io._exr import white_luminance
from skylight.io._files import (
    read_environment_map,
    read_light,
    write_environment_map,
    write_light,
)
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import (
    DirectionGrid,
    angle_between,
    angles_from_direction,
    direction_from_angles,
)
from skylight.sphere._projections import looks


@pytest.mark.parametrize("convention", get_args(Convention))
def test_conventions_come_back_exactly(probe: Path, tmp_path: Path, convention: str) -> None:
    there, back = tmp_path / "there.exr", tmp_path / "back.exr"
    assert main(["convert", str(probe), str(there), "--convention", convention]) == 0
    assert main(["convert", str(there), str(back), "--from-convention", convention]) == 0
    assert torch.equal(read_light(back), read_light(probe))
    rolled = read_light(there)
    column = int(rolled[4].sum(1).argmax())
    # our column 20 of 32 lies an eighth of a turn right of -Z
    centres = {"skylight": 20, "openexr": 4, "mitsuba": 4}
    assert column == centres.get(convention, 12)


@pytest.mark.parametrize("kind", [name for name in get_args(MapLayout) if name != "latlong"])
def test_projections_keep_light_and_sun(probe: Path, tmp_path: Path, kind: str) -> None:
    there, back = tmp_path / "there.exr", tmp_path / "back.exr"
    if kind == "cube-faces":
        there = tmp_path / "face_{}.exr"
    # 64 pixels a face
    size = ["--height", {"cube-vertical": "256", "cube-column": "384"}.get(kind, "192")]
    if kind in ("cube-row", "cube-faces"):
        size = ["--height", "64"]
    assert main(["convert", str(probe), str(there), "--to", kind, *size]) == 0
    assert main(["convert", str(there), str(back), "--from", kind]) == 0
    before, after = read_environment_map(probe), read_environment_map(back)
    torch.testing.assert_close(after.integrate(), before.integrate(), rtol=0.1, atol=0)
    cosine = before.brightest_direction().double() @ after.brightest_direction().double()
    assert float(cosine) > 0.99


def sun_of(path: Path) -> Float[Tensor, "3"]:
    return read_environment_map(path).brightest_direction(below=True).double()


def test_light_turns_to_the_right_and_keeps_its_energy(probe: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.exr"
    before = read_environment_map(probe)
    azimuth, zenith = angles_from_direction(sun_of(probe))
    for turn in (90.0, 33.0, -170.0):
        assert main(["convert", str(probe), str(out), "--rotate", str(turn)]) == 0
        after = read_environment_map(out)
        expected = direction_from_angles(azimuth + math.radians(turn), zenith)
        assert float(angle_between(sun_of(out), expected)) < math.radians(1.5)
        torch.testing.assert_close(after.integrate(), before.integrate(), rtol=1e-5, atol=0)
    assert main(["convert", str(probe), str(out), "--rotate", "90"]) == 0
    assert torch.equal(read_light(out), read_light(probe).roll(8, 1))


@pytest.mark.parametrize(
    ("options", "before", "after"),
    [
        (["--pitch", "30"], (0, 0, -1), (0, 0.5, -math.sqrt(0.75))),  # ahead: up
        (["--roll", "30"], (0, 1, 0), (0.5, math.sqrt(0.75), 0)),  # above: to the right
        (["--roll", "30"], (0, 0, -1), (0, 0, -1)),
        # rolled first, then pitched, then turned
        (["--rotate", "90", "--pitch", "90", "--roll", "90"], (0, 1, 0), (0, 0, 1)),
        (["--rotate", "90", "--pitch", "90", "--roll", "90"], (0, 0, -1), (0, 1, 0)),
    ],
)
def test_light_turns_about_any_axis(
    tmp_path: Path, options: list[str], before: tuple[float, ...], after: tuple[float, ...]
) -> None:
    source, out = tmp_path / "in.exr", tmp_path / "out.exr"
    grid = DirectionGrid.latlong(64)
    towards = torch.tensor(before, dtype=torch.float64)
    lobe = 50 * torch.exp(400 * (grid.directions @ towards - 1))
    light = EnvironmentMap(radiance=(0.2 + lobe)[:, None].expand(-1, 3).reshape(64, 128, 3).float())
    write_environment_map(source, light)
    assert main(["convert", str(source), str(out), *options]) == 0
    expected = torch.tensor(after, dtype=torch.float64)
    turned = read_environment_map(out)
    seen = turned.mean_direction(upper_only=False)
    assert float(angle_between(seen, expected)) < math.radians(0.5)
    torch.testing.assert_close(turned.integrate(), light.integrate(), rtol=0.01, atol=0)


def test_a_sun_of_one_pixel_keeps_its_energy_when_pitched(probe: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.exr"
    before = read_environment_map(probe).integrate()
    for pitch in (-70, -20, 15, 40, 160):
        assert main(["convert", str(probe), str(out), "--pitch", str(pitch)]) == 0
        after = read_environment_map(out).integrate()
        torch.testing.assert_close(after, before, rtol=0.1, atol=0)


def test_scale_and_stops_multiply(probe: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.exr"
    assert main(["convert", str(probe), str(out), "--scale", "3", "--ev", "-1"]) == 0
    torch.testing.assert_close(read_light(out), 1.5 * read_light(probe))


def test_what_a_map_says_of_its_unit_stays_true(probe: Path, tmp_path: Path) -> None:
    source, out = tmp_path / "lit.exr", tmp_path / "out.exr"
    write_environment_map(source, read_environment_map(probe), header={"whiteLuminance": 300.0})
    for kind in ("latlong", "cube-row"):
        assert main(["convert", str(source), str(out), "--to", kind, "--ev", "1"]) == 0
        assert white_luminance(out) == pytest.approx(150)
    assert main(["convert", str(probe), str(out)]) == 0
    assert white_luminance(out) is None


@pytest.mark.parametrize(("kind", "shape"), [("latlong", (16, 32)), ("cube-faces", (6, 36))])
def test_a_preview_shows_what_was_written(
    probe: Path, tmp_path: Path, kind: str, shape: tuple[int, int]
) -> None:
    out = tmp_path / ("out.exr" if kind == "latlong" else "{}.exr")
    seen = tmp_path / "seen.png"
    command = ["convert", str(probe), str(out), "--to", kind, "--preview", str(seen)]
    assert main([*command, "--height", str(shape[0])]) == 0
    with Image.open(seen) as image:
        codes = np.asarray(image)
    assert codes.shape == (*shape, 3)
    if kind == "latlong":
        assert np.array_equal(codes, preview(read_light(out)))
    else:  # the sun, above on the right, on the second of the six
        assert 1 <= codes.min(2).max(0).argmax() / 6 < 2


def test_a_sky_gets_a_dark_half_and_a_size_can_be_chosen(tmp_path: Path) -> None:
    sky = EnvironmentMap(radiance=torch.ones(8, 32, 3))
    write_environment_map(tmp_path / "sky.hdr", sky)
    out = tmp_path / "ball.exr"
    assert main(["convert", str(tmp_path / "sky.hdr"), str(out), "--to", "angular"]) == 0
    picture = read_light(out)
    assert picture.shape == (30, 30, 3)
    assert picture[5, 15].min() > 0.9
    assert picture[25, 15].max() == 0
    small = tmp_path / "small.exr"
    assert main(["convert", str(tmp_path / "sky.hdr"), str(small), "--height", "4"]) == 0
    assert read_light(small).shape == (4, 16, 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--to", "cube", "--convention", "unity"], "leave it out for cube"),
        (["--to", "cube", "--height", "64"], "cube cannot have 64 rows"),
        (["--to", "cube-column", "--height", "64"], "cube-column cannot have 64 rows"),
        (["--from", "cube-row"], "six times as wide as high"),
        (["--rotate", "400"], "-360 to 360 degrees"),
        (["--scale", "0"], "a number above 0"),
        (["--ev", "100"], "stops from -60 to 60"),
        (["--preview", "seen.jpg"], "ends in .png"),
        (["--from", "cube"], "32x16 (width x height) is no cross"),
        (["--from", "angular"], "has 16 columns, not 32"),
        (["--height", "7"], "even number of rows"),
    ],
)
def test_what_cannot_be_is_told_and_nothing_written(
    probe: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    out = probe.parent / "out.exr"
    assert main(["convert", str(probe), str(out), *options]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_a_cross_that_stands_is_the_one_that_lies(probe: Path, tmp_path: Path) -> None:
    lying, standing, back = (tmp_path / f"{name}.exr" for name in ("lying", "standing", "back"))
    assert main(["convert", str(probe), str(lying), "--to", "cube", "--height", "24"]) == 0
    cross = read_light(lying)
    below = cross[8:16, 24:].flip(0, 1)  # +Z, which continues -Y, upside down
    dark = torch.zeros(8, 8, 3)
    tall = torch.cat([cross[:, :24], torch.cat([dark, below, dark], 1)])
    write_light(standing, tall, header={})
    for source in (lying, standing):
        assert main(["convert", str(source), str(back), "--from", "cube"]) == 0
        if source == lying:
            wanted = read_light(back)
    assert torch.equal(read_light(back), wanted)
    # what lies on the two sides of the edge between -Y and +Z is near on the sphere too
    directions = looks("cube", torch.tensor([0.375]), torch.tensor([1.0])).directions
    behind = looks("cube", torch.tensor([0.875]), torch.tensor([2 / 3 - 1e-6])).directions
    torch.testing.assert_close(directions, behind, atol=1e-4, rtol=0)


def test_layers_and_repair_reach_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    light = np.ones((8, 16, 3), np.float32)
    bad = light.copy()
    bad[2, 3] = np.inf
    layers = {"a.R": light, "b.R": bad}
    channels = {
        key.replace("R", c): value[..., 0].copy() for key, value in layers.items() for c in "RGB"
    }
    source, out = tmp_path / "in.exr", tmp_path / "out.exr"
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(source))
    command = ["convert", str(source), str(out)]
    assert main(command) == 2
    assert "several layers, a, b" in capsys.readouterr().err
    assert main([*command, "--layer", "b"]) == 2
    assert "--repair" in capsys.readouterr().err
    assert main([*command, "--layer", "b", "--repair"]) == 0
    assert float(read_light(out).max()) == 65504
    assert main([*command, "--layer", "a"]) == 0
    assert float(read_light(out).max()) == 1


def test_maps_of_odd_sizes_are_told_what_to_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """750 x 375 is a lat-long map, but has no row at the horizon and no quarter of its columns."""
    odd, even = tmp_path / "odd.exr", tmp_path / "even.exr"
    write_environment_map(odd, EnvironmentMap(radiance=torch.rand(15, 30, 3)))
    export = ["export", "light", str(odd), str(tmp_path / "ar"), "--as", "ar"]
    for command in (export, ["convert", str(odd), str(even), "--convention", "blender"]):
        assert main(command) == 2
        assert "skylight convert IN OUT --height 14" in capsys.readouterr().err
    assert main(["convert", str(odd), str(even), "--height", "14", "--convention", "blender"]) == 0
    export[2] = str(even)
    assert main(export) == 0
    (tmp_path / "file").touch()
    export[3] = str(tmp_path / "file")
    assert main(export) != 0
    told = capsys.readouterr().err
    assert "it is a file" in told
    assert "--out" not in told
