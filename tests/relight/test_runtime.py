import json
import math
import subprocess
import sys
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from skylight.errors import AssetError, InputError, OutputError
from skylight.imaging._colour import tone_map as torch_tone_map
from skylight.io._files import write_environment_map
from skylight.io._light import read_linear
from skylight.models._ground import LambertianGround
from skylight.relight import _runtime as runtime
from skylight.relight._decoder import SkyDecoder, read_latent
from skylight.relight._export import make_scene, pack_visibility
from skylight.relight._runtime import (
    add_ground,
    load_scene,
    read_probe,
    relight,
    relight_files,
    rotate_columns,
    tone_map,
)
from skylight.sphere._envmap import EnvironmentMap, shift_columns
from skylight.sphere._frame import DirectionGrid
from skylight.transport._scene import diffuse_surface, evaluation_scene


def random_map(height, width, seed=0):
    """Radiance over three orders of magnitude."""
    generator = torch.Generator().manual_seed(seed)
    return torch.exp(2 * torch.randn(height, width, 3, generator=generator))


# The formulas written twice, in torch and in numpy


@pytest.mark.parametrize("azimuth", [0.0, 0.3, -2.0, math.pi, 9.0])
def test_rotate_columns_is_shift_columns(azimuth):
    sky = random_map(32, 128)
    expected = shift_columns(sky[None], torch.tensor([azimuth]))[0]
    np.testing.assert_allclose(rotate_columns(sky.numpy(), azimuth), expected, rtol=1e-4)


@pytest.mark.parametrize("columns", [13.0, -40.5])
def test_a_decoded_sky_turns_as_the_light_model_turns_it(light, decoder_path, columns):
    """By parts of a column the runtime interpolates pixels, where the model evaluates anew: what
    they shed is the same."""
    params = torch.randn(1, 65, generator=torch.Generator().manual_seed(1))
    decoder = SkyDecoder(decoder_path)
    params[0, 64] = decoder.centre_azimuth_rad + columns * 2 * math.pi / 128
    sky = decoder.decode(params[:, :64].numpy())[0]
    got = rotate_columns(sky, float(params[0, 64]) - decoder.centre_azimuth_rad).reshape(-1, 3)
    wanted = light(params)[0].numpy()
    if columns == round(columns):
        np.testing.assert_allclose(got, wanted, rtol=1e-3, atol=1e-4)
    weights = DirectionGrid.sky(32).solid_angles.numpy()
    np.testing.assert_allclose(weights @ got, weights @ wanted, rtol=0.02)


def test_add_ground_is_the_lambertian_ground():
    sky, albedo = random_map(32, 128), (0.1, 0.2, 0.3)
    expected = LambertianGround(32).append(sky.reshape(1, -1, 3), torch.tensor([albedo]))
    got = add_ground(sky.numpy(), albedo)
    np.testing.assert_allclose(got.reshape(-1, 3), expected[0], rtol=1e-5)


@pytest.mark.parametrize("height", [64, 100, 16])
def test_resize_is_the_environment_maps(height):
    probe = random_map(64, 128)
    expected = EnvironmentMap(radiance=probe).resize(height).radiance
    np.testing.assert_allclose(runtime.resize(probe.numpy(), height), expected, rtol=1e-5)


@pytest.mark.parametrize("white", [None, 2.0])
def test_tone_map_is_the_package_s(white):
    picture = random_map(40, 50)
    expected = torch_tone_map(picture, white=white).astype(int)
    assert np.abs(tone_map(picture.numpy(), white=white) - expected).max() <= 1  # a rounding apart
    assert tone_map(np.zeros((4, 4, 3), np.float32)).max() == 0


@pytest.mark.parametrize("height", [64, 128])
def test_relight_is_the_evaluation_scene_s(height, tmp_path):
    torch_scene = evaluation_scene(24)
    diffuse = torch_scene.diffuse
    make_scene(
        camera=torch_scene.camera,
        pixels=diffuse.pixels,
        normals=diffuse_surface(torch_scene.camera)[0].normals,
        albedo=torch_scene.albedo,
        on_ground=torch.zeros(len(diffuse), dtype=torch.bool),
        visible=pack_visibility(torch_scene.transport),
        grid=torch_scene.grid,
    ).save(tmp_path / "scene.npz")
    environment = EnvironmentMap(radiance=random_map(height, 2 * height))
    got = relight(load_scene(tmp_path / "scene.npz"), environment.radiance.numpy())
    expected = torch_scene.relight(environment).numpy()
    np.testing.assert_allclose(got, expected, rtol=2e-3, atol=1e-4)
    inside = got[diffuse.pixels[:, 0], diffuse.pixels[:, 1]]
    np.testing.assert_allclose(inside, torch_scene.shade(environment), rtol=2e-5)


# Without torch


def test_it_runs_where_importing_torch_raises(scene_path, decoder_path, tmp_path):
    (tmp_path / "z.json").write_text(json.dumps([0.5] * 64))
    write_environment_map(tmp_path / "x.exr", EnvironmentMap(radiance=random_map(32, 64)))
    program = f"""
import sys
sys.modules["torch"] = None  # import torch raises ImportError
from skylight.relight._runtime import relight_files
relight_files({str(scene_path)!r}, "a.png", latent="z.json", azimuth_deg=70,
              decoder={str(decoder_path)!r})
relight_files({str(scene_path)!r}, "b.exr", probe="x.exr")
try:
    import torch
except ImportError:
    print("no torch")
"""
    ran = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (ran.returncode, ran.stdout) == (0, "no torch\n"), ran.stderr
    assert np.ptp(np.asarray(Image.open(tmp_path / "a.png"))) > 50
    expected = relight(load_scene(scene_path), read_linear(tmp_path / "x.exr"))
    np.testing.assert_allclose(read_linear(tmp_path / "b.exr"), expected, rtol=1e-4)


# Files


def written(path, content):
    path.write_text(json.dumps(content))
    return path


def test_an_estimate_brings_its_azimuth_exposure_and_ground(scene_path, decoder_path, tmp_path):
    z = torch.randn(64, generator=torch.Generator().manual_seed(2)).tolist()
    estimate = {
        "light": "autoencoder",
        "params": [*z, 1.2],
        "exposure": 3.0,
        "ground_albedo": [0.1, 0.2, 0.3],
        "advice": [],
    }
    relight_files(
        scene_path,
        tmp_path / "a.exr",
        latent=written(tmp_path / "estimate.json", estimate),
        decoder=decoder_path,
    )
    decoder = SkyDecoder(decoder_path)
    sky = decoder.decode(np.array([z], np.float32))[0]
    turned = rotate_columns(sky, 1.2 - decoder.centre_azimuth_rad)
    probe = 3 * add_ground(turned, (0.1, 0.2, 0.3))
    expected = relight(load_scene(scene_path), probe, (0.1, 0.2, 0.3))
    np.testing.assert_allclose(read_linear(tmp_path / "a.exr"), expected, rtol=1e-5)

    options = {"azimuth_deg": math.degrees(1.2), "exposure": 3.0, "decoder": decoder_path}
    plain = written(tmp_path / "z.json", {"latent": z})
    for name, file in (("b.exr", plain), ("c.exr", tmp_path / "estimate.json")):
        relight_files(scene_path, tmp_path / name, latent=file, ground_albedo=0.4, **options)
    np.testing.assert_allclose(
        read_linear(tmp_path / "b.exr"), read_linear(tmp_path / "c.exr"), rtol=1e-4
    )


def test_a_sky_probe_gets_a_ground_and_an_exposure(scene_path, tmp_path):
    sky = EnvironmentMap(radiance=random_map(16, 64))
    write_environment_map(tmp_path / "sky.exr", sky)
    relight_files(scene_path, tmp_path / "a.exr", probe=tmp_path / "sky.exr", exposure=2.0)
    probe = 2 * add_ground(sky.radiance.numpy(), (0.2, 0.2, 0.2))
    expected = relight(load_scene(scene_path), probe)
    np.testing.assert_allclose(read_linear(tmp_path / "a.exr"), expected, rtol=1e-4)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([0.0] * 63, '"latent" must have 64 numbers, got 63'),
        ({"latent": 3}, "got a int"),
        ({"latent": [0.0] * 63 + [float("nan")]}, "NaN is no number"),
        ({"latent": [0.0] * 63 + ["1"]}, "place 63: '1'"),
        ({"latent": [0.0] * 63 + [10**400]}, "is no number"),
        ({"latent": [0.0] * 63 + [1e39]}, "place 63: 1e\\+39"),
        ({"params": [0.0] * 64}, '"params" must have 65 numbers, got 64'),
        ({"params": [0.0] * 10, "light": "sunsky"}, "another light model"),
        ({"latent": [0.0] * 64, "exposure": 0}, "exposure"),
        ({"latent": [0.0] * 64, "exposure": True}, "exposure"),
        ({"latent": [0.0] * 64, "ground_albedo": [0.1, 0.1, 2]}, "from 0 to 1"),
        ({"z": [0.0] * 64}, 'an object with "latent"'),
        (
            {"params": [0.0] * 65, "versions": {"skylight": "0.1.0"}},
            r"skylight 0\.1\.0, whose sky decoder was another; relight with the probe\.exr",
        ),
        (7, "expected 64 numbers"),
    ],
)
def test_bad_latents(tmp_path, content, message):
    with pytest.raises(InputError, match=message):
        read_latent(written(tmp_path / "z.json", content))


def test_latent_files_that_are_missing_or_no_json(tmp_path):
    with pytest.raises(InputError, match="cannot read"):
        read_latent(tmp_path / "none.json")
    (tmp_path / "z.json").write_text("{")
    with pytest.raises(InputError, match="no JSON"):
        read_latent(tmp_path / "z.json")


def test_a_picture_takes_little_more_memory_than_its_pixels(scene_path):
    scene = replace(load_scene(scene_path), layout=(1000, 2000))
    tracemalloc.start()
    picture = relight(scene, random_map(16, 32).numpy())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < picture.nbytes + 80e6  # two blocks of 2^23 entries


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "either a latent"),
        ({"probe": "x.exr", "latent": "z.json"}, "either a latent"),
        ({"probe": "none.exr"}, "no such file"),
        ({"probe": "x.png"}, "no such file"),
        ({"probe": "x.exr", "out": "a.jpg"}, ".png or .exr"),
        ({"probe": "x.exr", "exposure": -1.0}, "exposure must be above 0"),
        ({"probe": "x.exr", "azimuth_deg": float("nan")}, "azimuth_deg must be a finite"),
        ({"probe": "x.exr", "ground_albedo": 1.5}, "ground_albedo must be from 0 to 1"),
        ({"probe": "x.exr", "scene": "none.npz"}, "no such scene"),
        ({"probe": "x.exr", "scene": "bad.npz"}, "damaged, or no scene"),
        ({"probe": "x.exr", "scene": "other.npz"}, "damaged, or no scene"),
        ({"probe": "x.exr", "scene": "cut.npz"}, "damaged, or no scene"),
        ({"probe": "x.exr", "scene": "halves.npz"}, "a layout of float64"),
        ({"probe": "x.exr", "scene": "backwards.npz"}, "is no size of a picture"),
        ({"probe": "x.exr", "scene": "huge.npz"}, "13434886 are more than 8388608 pixels"),
        ({"probe": "x.exr", "scene": "fine.npz"}, "1448x724 are more than 131072 pixels"),
        ({"probe": "x.exr", "exposure": 1e38}, "too bright"),
    ],
)
def test_bad_options(scene_path, tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    write_environment_map("x.exr", EnvironmentMap(radiance=random_map(16, 32)))
    (tmp_path / "bad.npz").write_bytes(b"nothing")
    np.savez("other.npz", a=np.zeros(3))
    (tmp_path / "cut.npz").write_bytes(scene_path.read_bytes()[:-2000])
    whole = dict(np.load(scene_path))
    np.savez("halves.npz", **(whole | {"grid_layout": whole["grid_layout"].astype(float)}))
    np.savez("backwards.npz", **(whole | {"grid_layout": -whole["grid_layout"]}))
    np.savez("huge.npz", **(whole | {"layout": np.array([13434886, 8])}))
    np.savez("fine.npz", **(whole | {"grid_layout": np.array([724, 1448])}))
    there = set(tmp_path.iterdir())
    options = {"scene": scene_path, "out": "a.png"} | options
    with pytest.raises(InputError, match=message) as raised:
        relight_files(**options)
    assert "\n" not in str(raised.value)
    assert set(tmp_path.iterdir()) == there


def test_probes_are_checked(tmp_path):
    from skylight.io._hdr import write_exr

    bad = np.ones((16, 32, 3), np.float32)
    bad[3, 4, 1] = np.nan
    write_exr(tmp_path / "nan.exr", bad, half=False, header={})
    with pytest.raises(InputError, match=r"1 NaN pixel\(s\), the first at row 3, column 4"):
        read_probe(tmp_path / "nan.exr")
    write_exr(tmp_path / "square.exr", np.ones((16, 16, 3), np.float32), half=False, header={})
    with pytest.raises(InputError, match="16x16"):
        read_probe(tmp_path / "square.exr")


def test_decoders_are_checked(tmp_path, decoder_path, capfd):
    with pytest.raises(AssetError, match="skylight export decoder"):
        SkyDecoder(tmp_path / "none.onnx")
    (tmp_path / "bad.onnx").write_bytes(b"nothing")
    with pytest.raises(AssetError, match="damaged"):
        SkyDecoder(tmp_path / "bad.onnx")
    no_text = decoder_path.read_bytes().replace(b"latent", b"\xfeatent", 1)
    with pytest.raises(AssetError, match="damaged"):
        SkyDecoder(no_text)
    assert capfd.readouterr() == ("", "")  # onnxruntime would print


def test_a_folder_that_is_not_there(scene_path, tmp_path):
    write_environment_map(tmp_path / "x.exr", EnvironmentMap(radiance=random_map(16, 32)))
    with pytest.raises(OutputError, match="cannot write"):
        relight_files(scene_path, tmp_path / "none" / "a.png", probe=tmp_path / "x.exr")
