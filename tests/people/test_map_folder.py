"""Folders of maps: which map lights a scene, how it is turned, and what is refused."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import stats

from skylight.cli import main
from skylight.errors import InputError
from skylight.io._files import write_environment_map
from skylight.people._light import RenderOptions, scene_light
from skylight.people._maps import MapFolder
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import angle_between


def lit(row: int, column: int, height: int = 16) -> EnvironmentMap:
    """A grey room with a lamp of one pixel, of a tenth to ten times the rest's power."""
    radiance = torch.full((height, 2 * height, 3), 0.1)
    radiance[row, column] = torch.tensor([300.0, 200.0, 100.0])
    return EnvironmentMap(radiance=radiance)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two maps of different sizes, whose index names a category of one."""
    maps = tmp_path / "maps"
    maps.mkdir()
    write_environment_map(maps / "b.exr", lit(7, 16))
    write_environment_map(maps / "a.hdr", lit(40, 5, height=96))
    (maps / "index.csv").write_text("file,category\nb.exr,indoor\n")
    (maps / "notes.txt").write_text("no map")
    return maps


def test_maps_come_in_the_order_of_their_names_over_and_over(folder: Path) -> None:
    maps = MapFolder.read(folder)
    assert maps.files == ("a.hdr", "b.exr")
    assert maps.categories == (None, "indoor")
    options = RenderOptions(maps=maps)
    which = [scene_light(scene, options).turned_map for scene in range(4)]
    assert [one and one.file for one in which] == ["a.hdr", "b.exr", "a.hdr", "b.exr"]
    assert len({one and one.turn_deg for one in which}) == 4


@pytest.mark.parametrize("number", [0, 1])
def test_energy_is_kept(folder: Path, number: int) -> None:
    """Of maps that are larger and smaller than the light, turned by no whole pixel."""
    light, _, _ = MapFolder.read(folder).turned(number, 0.777)
    before = lit(40, 5, height=96) if number == 0 else lit(7, 16)
    assert light.layout == (64, 128)
    # RGBE of a.hdr rounds by 0.4 %
    torch.testing.assert_close(light.integrate(), before.integrate(), rtol=4e-3, atol=0)


def test_a_turn_goes_to_the_right(folder: Path) -> None:
    light, which, _ = MapFolder.read(folder).turned(1, math.pi / 2)
    # b's lamp is half a pixel to the right of straight ahead, half a pixel above the horizon
    half = math.pi / 32
    right = torch.tensor([math.cos(half) ** 2, math.sin(half), math.sin(half) * math.cos(half)])
    lamp = EnvironmentMap(radiance=light.radiance - 0.1).mean_direction()
    assert math.degrees(float(angle_between(lamp, right.double()))) < 0.5
    assert which.turn_deg == pytest.approx(90)


def test_turns_are_uniform_over_scenes(folder: Path) -> None:
    options = RenderOptions(maps=MapFolder.read(folder))
    lights = [scene_light(scene, options).turned_map for scene in range(100)]
    turns = [one.turn_deg for one in lights if one is not None]
    assert stats.kstest(np.array(turns) / 360 + 0.5, "uniform").pvalue > 0.05
    # a scene's is the same whatever was asked for before, and another seed's is another
    other = scene_light(99, replace(options, seed=1)).turned_map
    scene_light.cache_clear()
    assert scene_light(99, options).turned_map == lights[99] != other


def test_a_given_map_tells_of_no_sky(folder: Path) -> None:
    light = scene_light(0, RenderOptions(maps=MapFolder.read(folder)))
    assert light.sun is light.ground_albedo is light.transmittance is light.sky_seed is None
    assert 1.4 <= light.focal <= 2.8


def test_a_folder_of_faces_depends_on_the_maps_wherever_they_lie(
    folder: Path, tmp_path: Path
) -> None:
    options = RenderOptions(maps=MapFolder.read(folder))
    before = options.settings()
    moved = folder.rename(tmp_path / "moved")
    assert replace(options, maps=MapFolder.read(moved)).settings() == before
    write_environment_map(moved / "b.exr", lit(8, 16))
    assert replace(options, maps=MapFolder.read(moved)).settings() != before
    write_environment_map(moved / "b.exr", lit(7, 16))
    (moved / "a.hdr").rename(moved / "c.hdr")
    assert replace(options, maps=MapFolder.read(moved)).settings() != before
    # so that folders of before there were maps go on
    assert "maps" not in RenderOptions().settings()


def test_what_cannot_light_anybody_is_refused_before_anything_is_rendered(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(maps: Path, *more: str) -> str:
        out = tmp_path / "faces"
        assert main(["faces", "render", "--maps", str(maps), "--out", str(out), *more]) == 2
        assert not out.exists()
        return capsys.readouterr().err

    assert "there is no such folder" in refused(tmp_path / "nowhere")
    assert "leave it out with --maps" in refused(folder, "--sunny")
    (empty := tmp_path / "empty").mkdir()
    assert "no maps in it" in refused(empty)
    for name, content in {
        "black.exr": EnvironmentMap(radiance=torch.zeros(16, 32, 3)),
        "sky.exr": EnvironmentMap(radiance=torch.ones(8, 32, 3)),
    }.items():
        write_environment_map(folder / name, content)
        expected = {"black.exr": "is black all over", "sky.exr": "shows the sky alone"}[name]
        assert f"{name}: {expected}" in refused(folder)
        (folder / name).unlink()
    (folder / "b.exr").write_bytes((folder / "b.exr").read_bytes()[:200])
    message = refused(folder)
    assert "b.exr: cannot be read: its header is damaged" in message
    assert len(message.strip().splitlines()) == 1
    with pytest.raises(InputError, match=r"b\.exr"):
        MapFolder.read(folder)


LIGHTS = """file,kind,azimuth_deg,zenith_deg,red,green,blue,radius_deg,in_map
b.exr,sun,20,60,3,2,1,0.2667,0
b.exr,lamp,-90,30,0.5,0.5,0.25,1.5,0
b.exr,window,100,80,9,9,9,20,1
"""


@pytest.fixture
def places(folder: Path) -> Path:
    """The folder as one of simulated places."""
    (folder / "index.csv").write_text("file,kind,split\nb.exr,outdoors,test\na.hdr,home,test\n")
    (folder / "lights.csv").write_text(LIGHTS)
    return folder


def test_lights_beside_a_place_are_added_once(places: Path) -> None:
    """The sun as a disc, turned with the map, and a lamp in the map; what it shows is there."""
    maps = MapFolder.read(places)
    assert maps.categories == ("home", "outdoors")
    light, which, sun = maps.turned(1, 0.5)
    assert sun is not None
    assert which.category == "outdoors"
    want = lit(7, 16).integrate() + torch.tensor([0.5, 0.5, 0.25])
    torch.testing.assert_close(light.integrate(), want, rtol=1e-5, atol=0)
    a, z = math.radians(20) + 0.5, math.radians(60)
    there = [math.sin(z) * math.sin(a), math.cos(z), -math.sin(z) * math.cos(a)]
    torch.testing.assert_close(sun.direction, torch.tensor(there).double(), rtol=0, atol=1e-6)
    scene = scene_light(1, RenderOptions(maps=maps))
    assert scene.light.sun is not None
    torch.testing.assert_close(scene.light.sun.irradiance, torch.tensor([3.0, 2.0, 1.0]))
    assert scene_light(0, RenderOptions(maps=maps)).light.sun is None


def test_maps_of_days_that_are_not_complete_are_left_out(places: Path) -> None:
    write_environment_map(places / "c.exr", lit(8, 16))
    assert MapFolder.read(places).files == ("a.hdr", "b.exr")
    (places / "lights.csv").unlink()  # a folder of other maps
    assert MapFolder.read(places).files == ("a.hdr", "b.exr", "c.exr")


def test_what_is_beside_the_maps_belongs_to_them(places: Path) -> None:
    before = MapFolder.read(places).sha256
    (places / "lights.csv").write_text(LIGHTS.replace("3,2,1", "3,2,2"))
    assert MapFolder.read(places).sha256 != before
    for damaged in ("b.exr,sun,x,60,3,2,1,0.2,0", "b.exr,sun,1,60,-3,2,1,0.2,0", "b.exr,sun"):
        (places / "lights.csv").write_text(LIGHTS.splitlines()[0] + "\n" + damaged + "\n")
        with pytest.raises(InputError, match=r"lights\.csv: no list of the maps' lights"):
            MapFolder.read(places)
