"""The .glb file as another program reads it."""

import io
import json
import struct
from pathlib import Path

import numpy as np
import torch
import trimesh
from PIL import Image

from skylight.imaging._colour import linear_to_srgb
from skylight.probes.voxel._lightmap import Lightmap
from skylight.probes.voxel._model import exposed_faces, star_probe
from skylight.probes.voxel._relight import write_glb


def test_every_corner_finds_its_own_slot_in_the_texture(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    light = torch.rand(6, 32, 1, 1, 3, generator=torch.Generator().manual_seed(0))
    light = light.expand(-1, -1, 4, 4, -1).contiguous()
    one = Lightmap(radiance=light, coverage=torch.ones(6, 32), confidence=torch.ones(6, 32))
    write_glb(path, star_probe(3), one, voxel_size=2.0)
    mesh = trimesh.load(path, force="mesh", process=False)
    faces = exposed_faces(star_probe(3))
    np.testing.assert_allclose(mesh.vertices, 2 * faces.triangles()[0].numpy(), atol=1e-6)
    texture = np.asarray(mesh.visual.material.baseColorTexture.convert("RGB"))
    height, width, _ = texture.shape
    column = np.clip(mesh.visual.uv[:, 0] * width, 0, width - 1).astype(int)
    row = np.clip((1 - mesh.visual.uv[:, 1]) * height, 0, height - 1).astype(int)
    expected = linear_to_srgb(light[faces.orientation, faces.configuration, 0, 0])
    found = texture[row, column].reshape(-1, 4, 3) / 255
    np.testing.assert_allclose(found, expected.numpy()[:, None].repeat(4, 1), atol=0.6 / 255)


def test_nobody_lights_it_again(tmp_path: Path) -> None:
    """Read from the file's own JSON: an unlit material with the lightmap for its colour."""
    path = tmp_path / "a.glb"
    write_glb(path, star_probe(1), Lightmap.blank(2))
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    content = json.loads(data[20 : 20 + length])
    (material,) = content["materials"]
    assert content["extensionsUsed"] == ["KHR_materials_unlit"]
    # no mipmaps, which would mix neighbouring slots
    (sampler,) = content["samplers"]
    assert sampler["minFilter"] == sampler["magFilter"] == 9729
    assert [texture["sampler"] for texture in content["textures"]] == [0]
    assert material["extensions"] == {"KHR_materials_unlit": {}}
    assert material["pbrMetallicRoughness"]["baseColorTexture"]["index"] == 0
    view = content["bufferViews"][content["images"][0]["bufferView"]]
    start = 20 + length + 8 + view.get("byteOffset", 0)
    picture = Image.open(io.BytesIO(data[start : start + view["byteLength"]]))
    assert picture.size == (32, 24)
