import sys
from collections import Counter

import numpy as np
import onnx
import pytest
import torch
import trimesh

from skylight.errors import DependencyError, InputError, SkylightError
from skylight.models._convolutional import ConvolutionalAutoencoder
from skylight.models._network import CENTRE_AZIMUTH_RAD
from skylight.models._splines import SplineAutoencoder
from skylight.relight import _export as export
from skylight.relight._decoder import SkyDecoder
from skylight.relight._export import Placement, decoder_difference, export_decoder, precompute_scene
from skylight.relight._runtime import load_scene, relight
from tests.own_network import TinyNetwork


@pytest.mark.parametrize("batch", [1, 2, 7])
def test_onnxruntime_decodes_what_torch_decodes(light, decoder_path, batch):
    latents = 2 * torch.randn(batch, 64, generator=torch.Generator().manual_seed(batch))
    expected = light.network.decode(latents)
    assert expected.max() > 2 * expected.mean()  # no flat skies
    got = SkyDecoder(decoder_path).decode(latents.numpy())
    np.testing.assert_allclose(got, expected.numpy(), rtol=1e-4, atol=1e-5)


def test_the_graph_is_plain_and_says_what_it_is(decoder_path):
    model = onnx.load(decoder_path)
    operators = Counter(node.op_type for node in model.graph.node)
    assert "Einsum" not in operators
    assert operators["Gemm"] == 5
    assert operators["Gather"] <= 3
    assert decoder_path.stat().st_size < 5.2e6  # the weights in half precision
    assert SkyDecoder(decoder_path).centre_azimuth_rad == CENTRE_AZIMUTH_RAD
    said = {entry.key for entry in model.metadata_props}
    assert said == {"skylight_version", "centre_azimuth_rad", "radiance", "layout"}


def test_the_thesis_network_is_exported_with_its_kernels_folded(tmp_path):
    path = tmp_path / "decoder.onnx"
    assert export_decoder(ConvolutionalAutoencoder().eval(), path) < 1e-4
    operators = Counter(node.op_type for node in onnx.load(path).graph.node)
    assert "Einsum" not in operators
    assert operators["Conv"] == 5
    assert operators["DepthToSpace"] == 4
    assert path.stat().st_size < 4.2e6  # single precision: these weights would lose by less


@pytest.mark.slow
def test_other_numbers_of_latents_are_exported(tmp_path):
    path = tmp_path / "decoder.onnx"
    export_decoder(SplineAutoencoder(32).eval(), path)
    assert SkyDecoder(path).latents == 32


@pytest.mark.parametrize(
    ("layer", "refused"), [(torch.nn.GELU(), None), (torch.nn.Hardswish(), "'HardSwish'")]
)
def test_networks_of_other_layers_are_exported_or_told_why_not(tmp_path, layer, refused):
    class Other(TinyNetwork):
        def decode_coded(self, z):
            return layer(super().decode_coded(z))

    path = tmp_path / "decoder.onnx"
    if refused is None:
        assert export_decoder(Other(8).eval(), path) < 1e-4
        return
    with pytest.raises(InputError, match=f"Other makes no decoder .*{refused}.*: decode by other"):
        export_decoder(Other(8).eval(), path)
    assert not path.exists()


def test_another_network_is_told_apart(light, decoder_path):
    other = type(light.network)().eval()
    assert decoder_difference(decoder_path.read_bytes(), other, torch.randn(16, 64)) > 1e-2


@pytest.mark.parametrize("difference", [4e-4, float("nan")])
def test_a_graph_that_differs_is_not_written(light, tmp_path, monkeypatch, difference):
    monkeypatch.setattr(export, "_decoder_graph", lambda *_: b"a graph")
    monkeypatch.setattr(export, "decoder_difference", lambda *_: difference)
    with pytest.raises(SkylightError, match="differ from torch's"):
        export_decoder(light.network, tmp_path / "decoder.onnx")
    assert not list(tmp_path.iterdir())


def test_without_onnx_it_says_what_to_install(light, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(DependencyError, match=r"skylight-lighting\[export\]"):
        export_decoder(light, tmp_path / "decoder.onnx")


def test_furnace(scene_path):
    """A ball in white light shows its albedo, the ground beside it what the ball leaves free."""
    scene = load_scene(scene_path)
    picture = relight(scene, np.ones((64, 128, 3), np.float32), (0.5, 0.5, 0.5))
    shading = picture[scene.pixels[:, 0], scene.pixels[:, 1]]
    np.testing.assert_allclose(shading[~scene.on_ground], 0.7, atol=2e-3)

    # A sphere above the horizon takes cos(angle) (R / d)^2 of a plane's light (Howell B-43).
    # 2 / sqrt(12) scales the ball's bounding box, a cube, to a diagonal of 2.
    radius = 1 / np.sqrt(3)
    row, column = scene.pixels[scene.on_ground].astype(float).T + 0.5
    distance = 1.6 * scene.focal_px / (row - scene.center_px[1])
    x = (column - scene.center_px[0]) / scene.focal_px * distance
    away = np.sqrt(x**2 + (3.4 - distance) ** 2 + radius**2)
    free = 1 - radius**2 / away**2 * (radius / away)
    np.testing.assert_allclose(shading[scene.on_ground, 0], 0.5 * free, atol=6e-3)
    assert free.min() < 0.7


def test_the_shadow_lies_opposite_the_sun(scene_path):
    scene = load_scene(scene_path)
    probe = np.full((64, 128, 3), 0.01, np.float32)
    probe[16, 96] = 1000  # to the right, 45 degrees high
    picture = relight(scene, probe)
    left, right = picture[30:40, 12:22].mean(), picture[30:40, 42:52].mean()
    assert left < 0.5 * right


def test_meshes_of_all_kinds_stand_on_the_ground_alike(tmp_path):
    box = trimesh.creation.box(extents=(1.0, 2.0, 0.5))
    expected = precompute_scene(box, tmp_path / "box.npz", height=16)
    for suffix in ("obj", "ply", "glb"):
        box.export(tmp_path / f"box.{suffix}")
        got = precompute_scene(tmp_path / f"box.{suffix}", tmp_path / "got.npz", height=16)
        np.testing.assert_array_equal(got.visible, expected.visible)
    lying = trimesh.creation.box(extents=(1.0, 0.5, 2.0))  # the same one, up is z
    got = precompute_scene(
        lying, tmp_path / "got.npz", height=16, placement=Placement(up="z"), workers=2
    )
    np.testing.assert_array_equal(got.pixels, expected.pixels)
    np.testing.assert_allclose(got.normals, expected.normals, atol=1e-6)


def test_a_turn_adds_to_the_azimuth(tmp_path):
    """From +X, a quarter turn right of ahead, to half a turn: +Z, towards the camera."""
    wedge = trimesh.creation.box(extents=(1.0, 1.0, 1.0))
    wedge.vertices[wedge.vertices[:, 0] > 0, 1] *= 0.2  # lower on its +X side
    turned = Placement(turn_rad=np.pi / 2, ground=False)
    got = precompute_scene(wedge, tmp_path / "a.npz", height=24, placement=turned)
    top = got.normals[got.normals[:, 1] > 0.5].mean(0)
    assert top[2] > 0.2
    assert abs(top[0]) < 1e-3
    assert not got.on_ground.any()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none.obj", None, "there is no such mesh"),
        ("mesh.txt", b"v 0 0 0", "no mesh known"),
        ("bad.obj", b"nothing", "no faces"),
        ("bad.ply", b"nothing", "does not begin"),
        ("bad.glb", b"", "not read as .glb"),
        ("point.obj", b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "no extent|no faces|has an area"),
        ("nan.obj", b"v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n", "NaN|no faces"),
    ],
)
def test_bad_meshes(tmp_path, name, content, message):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        precompute_scene(tmp_path / name, tmp_path / "out.npz", height=16)
    assert not (tmp_path / "out.npz").exists()
