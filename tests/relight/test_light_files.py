"""Lights written for other programs: each read as that program reads it."""

import json
import math
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from skylight.io._files import read_light
from skylight.relight._blender import SCRIPT, TEXTURE as BLENDER_TEXTURE, write_blender
from skylight.relight._gltf import LIGHT, write_gltf
from skylight.relight._harmonics import (
    AR_LIGHT,
    HARMONICS,
    second_degree,
    write_augmented_reality,
    write_harmonics,
)
from skylight.relight._scenes import LAYER, SCENE, USD_TEXTURE, write_mitsuba, write_usd
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, direction_from_angles
from skylight.sphere._projections import face_directions
from skylight.sphere._wavelets import texel_solid_angles
from tests.axis_colours import AXES, axis_map
from tests.oracles.harmonics import from_convention, irradiance
from tests.oracles.rgbd import decode_rgbd
from tests.relight.programs import mitsuba, seen_by_blender


def sunny_map() -> EnvironmentMap:
    """A sky that is bluer above, a dark ground, and a sun of 3 degrees."""
    grid = DirectionGrid.latlong(64)
    up = grid.directions[:, 1:2]
    sky = torch.tensor([0.7, 1.0, 1.5]) * (1 + 0.5 * up) * (up > 0) + 0.2 * (up <= 0)
    towards = direction_from_angles(torch.tensor(1.0), torch.tensor(0.8)).double()
    sun = torch.acos((grid.directions @ towards).clamp(-1, 1)) < math.radians(3)
    radiance = sky + sun[:, None] * torch.tensor([3000.0, 2800.0, 2300.0])
    return EnvironmentMap(radiance=radiance.reshape(64, 128, 3).float())


# a diffuse surface's light


def test_what_arcores_shader_adds_up_is_the_probes_irradiance(tmp_path: Path) -> None:
    light = sunny_map()
    names = write_augmented_reality(tmp_path, light, 64)
    assert sorted(names) == sorted(path.name for path in tmp_path.iterdir())
    told = json.loads((tmp_path / AR_LIGHT).read_text(encoding="utf-8"))
    main = told["main_light"]
    assert main["visible"]
    direction = torch.tensor(main["direction_towards_light"]).double()
    intensity = torch.tensor(main["intensity_rgb"]).double()
    ambient = from_convention(torch.tensor(told["ambient_harmonics"]["arcore"]).double(), "arcore")
    normals = DirectionGrid.hammersley(200).directions
    cosine = (normals @ light.grid.directions.T).clamp(min=0)
    exact = cosine * light.grid.solid_angles @ light.flat.double()
    found = irradiance(ambient, normals) + intensity * (normals @ direction).clamp(min=0)[:, None]
    error = (found - exact).abs()
    # of what a plane facing the sun receives; most of it is the harmonics'
    assert float(error.max()) < 0.01 * float(exact.max())
    assert float(error.mean()) < 0.005 * float(exact.max())
    # over all normals the triple's energy is the probe's: the mean irradiance is pi times the mean
    torch.testing.assert_close(found.mean(0), exact.mean(0), rtol=0.001, atol=0)
    # harmonics of the whole map, without a main light, are ten times worse
    worse = (irradiance(second_degree(light), normals) - exact).abs()
    assert float(worse.max()) > 10 * float(error.max())


def test_the_cube_map_shows_all_light_the_sun_too(tmp_path: Path) -> None:
    light = sunny_map()
    write_augmented_reality(tmp_path, light, 64)
    told = json.loads((tmp_path / AR_LIGHT).read_text(encoding="utf-8"))
    faces = torch.stack([read_light(tmp_path / name) for name in told["cube_map"]["order"]])
    solid = texel_solid_angles(64)[..., None]
    total = (faces.double() * solid).sum((0, 1, 2))
    torch.testing.assert_close(total, light.integrate().double(), rtol=0.05, atol=0)
    brightest = face_directions(64).reshape(-1, 3)[faces.sum(-1).argmax()]
    towards = torch.tensor(told["main_light"]["direction_towards_light"]).double()
    assert math.degrees(math.acos(float(brightest @ towards))) < 4


def test_faces_have_the_axes_colours(tmp_path: Path) -> None:
    write_augmented_reality(tmp_path, axis_map(), 32)
    for name, (_, colour) in AXES.items():
        middle = read_light(tmp_path / f"cube_{name}.hdr")[16, 16]
        assert middle.tolist() == pytest.approx(colour, abs=0.02)
    told = json.loads((tmp_path / AR_LIGHT).read_text(encoding="utf-8"))
    assert not told["main_light"]["visible"]


def test_harmonics_name_their_convention(tmp_path: Path) -> None:
    light = sunny_map()
    assert write_harmonics(tmp_path, light, "gltf") == [HARMONICS]
    told = json.loads((tmp_path / HARMONICS).read_text(encoding="utf-8"))
    assert told["convention"] == "gltf"
    assert told["numbers_are"].startswith("irradiance")
    again = from_convention(torch.tensor(told["sh"]).double(), "gltf")
    torch.testing.assert_close(again, second_degree(light), rtol=1e-5, atol=1e-4)


# glTF


def read_glb(path: Path) -> tuple[dict, bytes]:
    """JSON and binary chunk: glTF 2.0, 4.4."""
    data = path.read_bytes()
    magic, version, length = np.frombuffer(data[:12], "<u4")
    assert (magic, version, length) == (0x46546C67, 2, len(data))
    chunk, kind = np.frombuffer(data[12:20], "<u4")
    assert kind == 0x4E4F534A
    assert chunk % 4 == 0
    tree = json.loads(data[20 : 20 + chunk])
    size, kind = np.frombuffer(data[20 + chunk : 28 + chunk], "<u4")
    assert kind == 0x004E4942
    assert size == tree["buffers"][0]["byteLength"] == len(data) - 28 - chunk
    return tree, data[28 + chunk :]


def test_gltf_shows_each_axis_where_babylon_looks_for_it(tmp_path: Path) -> None:
    assert write_gltf(tmp_path, axis_map(32), 64) == ([LIGHT], 0)
    tree, binary = read_glb(tmp_path / LIGHT)
    assert tree["scenes"][tree["scene"]]["extensions"]["EXT_lights_image_based"] == {"light": 0}
    (light,) = tree["extensions"]["EXT_lights_image_based"]["lights"]
    assert light["specularImageSize"] == 64
    assert light["intensity"] == 1
    assert len(light["specularImages"]) == 3
    assert np.shape(light["irradianceCoefficients"]) == (9, 3)
    for depth, level in enumerate(light["specularImages"]):
        faces = []
        for number in level:
            image = tree["images"][number]
            view = tree["bufferViews"][image["bufferView"]]
            assert view["byteOffset"] % 4 == 0
            data = binary[view["byteOffset"] :][: view["byteLength"]]
            with Image.open(BytesIO(data)) as picture:
                assert picture.format == "PNG"
                assert (picture.mode, picture.size) == ("RGBA", (64 >> depth,) * 2)
                faces.append(decode_rgbd(np.asarray(picture)))
        # Babylon.js puts glTF's (x, y, z) at (-x, y, z) and looks OpenGL's cube map up there
        looked = face_directions(64 >> depth).numpy() * [-1, 1, 1]
        for axis, colour in AXES.values():
            place = np.unravel_index((looked @ axis).argmax(), looked.shape[:3])
            seen = faces[place[0]][place[1], place[2]]
            # level 2 is of roughness 1: its colours are mixed, but in their order
            if depth < 2:
                assert seen == pytest.approx(colour, abs=0.12)
            assert ((seen > 0.5) == (np.array(colour) > 0.5)).all()


def test_gltf_cuts_a_sun_that_rgbd_cannot_hold_and_says_how_much(tmp_path: Path) -> None:
    light = sunny_map()
    _, cut = write_gltf(tmp_path, light, 32)
    tree, binary = read_glb(tmp_path / LIGHT)
    (told,) = tree["extensions"]["EXT_lights_image_based"]["lights"]
    # Babylon.js multiplies diffuse light by it twice
    assert told["intensity"] == 1
    numbers = torch.tensor(told["irradianceCoefficients"]).double().reshape(-1)
    again = from_convention(numbers, "gltf")
    torch.testing.assert_close(again, second_degree(light), rtol=1e-4, atol=1e-3)
    total = np.zeros(3)
    for number in told["specularImages"][0]:
        view = tree["bufferViews"][tree["images"][number]["bufferView"]]
        data = binary[view["byteOffset"] :][: view["byteLength"]]
        with Image.open(BytesIO(data)) as picture:
            face = decode_rgbd(np.asarray(picture))
        total += (face * texel_solid_angles(32)[0, ..., None].numpy()).sum((0, 1))
    assert 0.3 < cut < 0.9
    # nothing is cut off where there is nothing
    assert write_gltf(tmp_path, EnvironmentMap(radiance=torch.zeros(16, 32, 3)), 32)[1] == 0
    assert total.sum() == pytest.approx((1 - cut) * float(light.integrate().sum()), rel=0.02)


# lat-long maps


def looked_up(picture: torch.Tensor, u: float, v: float) -> list[float]:
    """The pixel at u to the right and v down, 0 to 1."""
    height, width = picture.shape[:2]
    row, column = int(v * height * 0.999999), int((u % 1.0) * width)
    return picture[row, column].tolist()


def test_usd_texture_lies_as_openexr_says(tmp_path: Path) -> None:
    assert write_usd(tmp_path, axis_map()) == [LAYER, USD_TEXTURE]
    picture = read_light(tmp_path / USD_TEXTURE)
    for (x, y, z), colour in AXES.values():
        # longitude 0 is +Z, pi / 2 is +X; the left border has longitude pi, the right one -pi
        longitude, latitude = math.atan2(x, z), math.asin(y)
        u, v = 0.5 - longitude / (2 * math.pi), 0.5 - latitude / math.pi
        assert looked_up(picture, u, v) == pytest.approx(colour, abs=1e-3)


def test_usd_itself_reads_the_dome(tmp_path: Path) -> None:
    pxr = pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Usd, UsdGeom, UsdLux  # pyright: ignore

    assert pxr is not None
    write_usd(tmp_path, axis_map(16))
    stage = Usd.Stage.Open(str(tmp_path / LAYER))
    dome = UsdLux.DomeLight(stage.GetDefaultPrim())
    assert dome
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert dome.GetTextureFormatAttr().Get() == "latlong"
    assert dome.GetIntensityAttr().Get() == 1
    found = dome.GetTextureFileAttr().Get().resolvedPath
    assert Path(found).resolve() == (tmp_path / USD_TEXTURE).resolve()


def test_blender_texture_lies_as_cycles_looks_it_up(tmp_path: Path) -> None:
    assert write_blender(tmp_path, axis_map()) == [SCRIPT, BLENDER_TEXTURE]
    compile((tmp_path / SCRIPT).read_text(encoding="utf-8"), SCRIPT, "exec")
    picture = read_light(tmp_path / BLENDER_TEXTURE)
    for (x, y, z), colour in AXES.values():
        bx, by, bz = x, -z, y  # +Z up
        # Cycles, direction_to_equirectangular: u = 1/2 - atan2(y, x) / 2 pi, v upwards
        u = 0.5 - math.atan2(by, bx) / (2 * math.pi)
        v = math.acos(bz) / math.pi
        assert looked_up(picture, u, v) == pytest.approx(colour, abs=0.01)


ALONG_THE_AXES = """
scene.cycles.samples = 16
seen = {}
for name, (x, y, z) in asked.items():
    towards = mathutils.Vector((x, -z, y))
    camera.rotation_euler = towards.to_track_quat("-Z", "Y").to_euler()
    seen[name] = picture("seen_" + name)[1, 1, :3].tolist()
"""


def test_blender_itself_sees_the_axes(tmp_path: Path) -> None:
    write_blender(tmp_path, axis_map())
    # a little beside the poles, across which Cycles blends with the other one
    axes = {name: [x + 0.05, y, z + 0.03] for name, ((x, y, z), _) in AXES.items()}
    seen = seen_by_blender(tmp_path, ALONG_THE_AXES, axes)
    for name, (_, colour) in AXES.items():
        assert seen[name] == pytest.approx(colour, abs=0.02)


# Mitsuba


def test_mitsuba_itself_sees_the_axes_in_our_scene(tmp_path: Path) -> None:
    mi = mitsuba()
    write_mitsuba(tmp_path, axis_map())
    scene = mi.load_file(str(tmp_path / SCENE), spp=16, width=96, height=32)
    far = mi.Point3f(0, 50, 0)  # above the balls
    for axis, colour in AXES.values():
        start = far if axis[1] >= 0 else mi.Point3f(0, -50, 0)
        ray = mi.Ray3f(start, mi.Vector3f(*axis))
        seen = scene.environment().eval(scene.ray_intersect(ray))
        assert [float(c) for c in seen] == pytest.approx(colour, abs=0.03)
    picture = torch.from_numpy(np.array(mi.render(scene)))
    assert picture.shape == (32, 96, 3)
    # the mirror, left, shows +Z in its middle and the sides of the world near its rim
    assert picture[16, 16].tolist() == pytest.approx(AXES["pz"][1], abs=0.03)
    radius = 32 / (2 * 11 * math.tan(math.radians(18)) * 32 / 96)  # pixels of a ball
    step = round(radius * math.sin(math.pi / 4) * 0.95)
    middle = 48 - round(2.4 * radius)
    # its right side shows the ball beside it
    assert picture[16, middle - step].tolist() == pytest.approx(AXES["nx"][1], abs=0.1)
    assert picture[16 - step, middle].tolist() == pytest.approx(AXES["py"][1], abs=0.1)
    assert picture[15 + step, middle].tolist() == pytest.approx(AXES["ny"][1], abs=0.1)
