"""The .glb file as another program reads it, from its bytes alone."""

import io
import json
import struct
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from skylight.errors import InputError
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions.relight._atlas import Atlas
from skylight.probes.partitions.relight._export import (
    Baking,
    write_relightable_atlas,
    write_relightable_glb,
)
from tests.probes.partitions.boards import F64, box, fourteen, turn_about_y

ROTATION = turn_about_y(0.4)
_TYPES = {5126: np.dtype("<f4"), 5125: np.dtype("<u4")}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}


class Read:
    """glTF 2.0, binary: a JSON chunk and a chunk of bytes."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        magic, version, length = struct.unpack_from("<4sII", data)
        assert (magic, version, length) == (b"glTF", 2, len(data))
        (size,) = struct.unpack_from("<I", data, 12)
        self.tree = json.loads(data[20 : 20 + size])
        self.bytes = data[28 + size :]
        (self.mesh,) = self.tree["meshes"]
        (self.primitive,) = self.mesh["primitives"]

    def __getitem__(self, attribute: str) -> np.ndarray:
        return self.values(self.primitive["attributes"][attribute])

    def values(self, accessor: int) -> np.ndarray:
        told = self.tree["accessors"][accessor]
        view = self.tree["bufferViews"][told["bufferView"]]
        start = view.get("byteOffset", 0) + told.get("byteOffset", 0)
        kind, width = _TYPES[told["componentType"]], _WIDTHS[told["type"]]
        count = told["count"] * width
        return np.frombuffer(self.bytes, kind, count, start).reshape(-1, width)

    def texture(self) -> np.ndarray:
        """Codes of the only material's base colour."""
        material = self.tree["materials"][self.primitive["material"]]
        texture = self.tree["textures"][
            material["pbrMetallicRoughness"]["baseColorTexture"]["index"]
        ]
        view = self.tree["bufferViews"][self.tree["images"][texture["source"]]["bufferView"]]
        start = view.get("byteOffset", 0)
        data = self.bytes[start : start + view["byteLength"]]
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


@pytest.fixture
def probe() -> PartitionProbe:
    facing = fourteen().facing
    leaky = torch.diag(facing) + 0.01 * fourteen().neighbours.double()
    albedo = torch.tensor([0.8, 0.7, 0.6], dtype=F64)
    return PartitionProbe(fourteen(), albedo, response=leaky).requires_grad_(False)


def write(path: Path, probe: PartitionProbe, **kind) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    transfer = 0.1 * torch.rand(len(box().vertices), 14, 3, generator=generator)
    light = torch.rand(14, 3, generator=generator)
    baking = Baking(probe=probe, rotation=ROTATION, light=light, **kind)
    write_relightable_glb(path, box(), transfer, baking)
    return transfer, light


def test_baked_colours_come_back_from_the_coefficients(tmp_path, probe):
    path = tmp_path / "a.glb"
    transfer, light = write(path, probe, exposure=0.5)
    file = Read(path)
    facts = file.mesh["extras"]
    assert facts["kind"] == "skylight relightable mesh"
    lit = sum(
        file[name] * np.array(radiance)
        for name, radiance in zip(facts["attributes"], facts["light"], strict=True)
    )
    baked = file["COLOR_0"]
    np.testing.assert_allclose(facts["exposure"] * lit, baked, atol=1e-6)
    expected = 0.5 * torch.einsum("vnc,nc->vc", transfer, light)
    np.testing.assert_allclose(baked, expected.numpy(), atol=1e-5)
    assert 0.1 < baked.mean() < 0.9


def test_shading_of_a_probe_becomes_light_by_the_file_alone(tmp_path, probe):
    path = tmp_path / "a.glb"
    write(path, probe)
    facts = Read(path).mesh["extras"]
    shading = np.random.default_rng(0).random((14, 3))
    by_file = np.array(facts["inverse_response"]) @ (
        np.pi * shading / np.array(facts["kernel_albedo"])
    )
    np.testing.assert_allclose(by_file, probe.light(torch.from_numpy(shading)[None])[0])
    np.testing.assert_allclose(facts["weights"], probe.weights)
    np.testing.assert_allclose(
        np.array(facts["cell_directions"]), fourteen().normals @ ROTATION.T, atol=1e-12
    )
    np.testing.assert_allclose(sum(facts["cell_solid_angles"]), 4 * np.pi)
    # whoever has directions of the scene finds their cells by the closest seed
    directions = torch.nn.functional.normalize(
        torch.randn(50, 3, dtype=F64, generator=torch.Generator().manual_seed(1)), dim=1
    )
    closest = (directions.numpy() @ np.array(facts["seeds"]).T).argmax(1)
    cells = np.array(facts["cell_of_seed"])[closest]
    np.testing.assert_array_equal(cells, fourteen().cell_of(directions @ ROTATION).numpy())


def test_geometry_is_kept_and_nobody_lights_it_again(tmp_path: Path, probe: PartitionProbe) -> None:
    path = tmp_path / "a.glb"
    write(path, probe)
    file, scene = Read(path), box()
    np.testing.assert_allclose(file["POSITION"], scene.vertices, atol=1e-5)
    np.testing.assert_allclose(file["NORMAL"], scene.normals, atol=1e-6)
    triangles = file.values(file.primitive["indices"]).reshape(-1, 3)
    np.testing.assert_array_equal(triangles, scene.faces.numpy())
    assert file.tree["extensionsUsed"] == ["KHR_materials_unlit"]
    material = file.tree["materials"][file.primitive["material"]]
    assert material["extensions"] == {"KHR_materials_unlit": {}}
    assert set(file.primitive["attributes"]) == {
        "POSITION", "NORMAL", "COLOR_0", *(f"_T{i}" for i in range(14))
    }  # fmt: skip


def test_too_bright_colours_clip(tmp_path: Path, probe: PartitionProbe) -> None:
    path = tmp_path / "a.glb"
    write(path, probe, exposure=100.0)
    assert float(Read(path)["COLOR_0"].max()) == 1
    with pytest.raises(InputError, match="exposure"):
        write(path, probe, exposure=0.0)


def test_texels_are_relit_by_the_files_alone(tmp_path: Path, probe: PartitionProbe) -> None:
    """The texture is the coefficients' product with the light, and each texel a place."""
    pytest.importorskip("xatlas")
    path, scene = tmp_path / "a.glb", box(1.0)
    atlas = Atlas.of_charts(scene, 64)
    positions = atlas.receivers(scene).positions
    generator = torch.Generator().manual_seed(0)
    transfer = 0.1 * torch.rand(len(positions), 14, 3, generator=generator)
    # of this cell, what tells places
    transfer[:, 3] = (positions + torch.tensor([0.5, 0, 0.5])).float()
    light = torch.rand(14, 3, generator=generator)
    baking = Baking(probe=probe, rotation=ROTATION, light=light, exposure=0.4)
    write_relightable_atlas(path, scene, atlas, transfer, baking)
    file = Read(path)
    facts = file.mesh["extras"]
    with np.load(tmp_path / facts["atlas"], allow_pickle=False) as content:
        beside = {name: content[name] for name in content.files}
    assert json.loads(str(beside["extras"])) == facts
    assert beside["transfer"].shape == (14, 64, 64, 3)
    assert beside["transfer"].dtype == np.float16
    np.testing.assert_allclose(
        beside["transfer"][:, beside["coverage"]].transpose(1, 0, 2), transfer, atol=5e-4
    )
    lit = facts["exposure"] * np.einsum(
        "nhwc,nc->hwc", beside["transfer"].astype(float), facts["light"]
    )
    encoded = np.where(lit > 0.0031308, 1.055 * np.abs(lit) ** (1 / 2.4) - 0.055, 12.92 * lit)
    # half a code for its rounding, and some for that of float16
    np.testing.assert_allclose(file.texture(), 255 * encoded.clip(0, 1), atol=0.6)
    assert 0.1 < lit.mean() < 0.9

    assert set(file.primitive["attributes"]) == {"POSITION", "NORMAL", "TEXCOORD_0"}
    triangles = file.values(file.primitive["indices"]).reshape(-1, 3)
    middles = file["POSITION"][triangles].mean(1) + np.array([0.5, 0, 0.5])
    column, row = (file["TEXCOORD_0"][triangles].mean(1) * 64).astype(int).T
    texel = 1 / np.sqrt(beside["coverage"].sum() / 6)
    there = beside["transfer"][3, row, column].astype(float)
    assert np.abs(there - middles).max() < texel
    corners = np.sort(file["POSITION"][triangles], 1)
    np.testing.assert_allclose(corners, np.sort(scene.vertices[scene.faces], 1), atol=1e-6)
    (sampler,) = file.tree["samplers"]
    assert sampler["minFilter"] == sampler["magFilter"] == 9729
