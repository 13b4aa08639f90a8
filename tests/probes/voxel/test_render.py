"""Drawing by texture mapping: which slot is seen, how it is interpolated, the window, the .glb."""

import io
import json
import struct
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from skylight.imaging._colour import linear_to_srgb
from skylight.probes.cameras._drawing import camera_rays, lens_rays, looking_at
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.voxel._lightmap import Lightmap
from skylight.probes.voxel._model import VoxelModel, exposed_faces, star_probe
from skylight.probes.voxel._relight import VoxelRenderer, write_glb
from skylight.sphere._rotation import RigidTransform
from skylight.transport._cameras import Camera

F64 = torch.float64


def camera(size: int = 64, focal: float = 120.0) -> Camera:
    return Camera(focal_px=focal, width=size, height=size, center_px=(size / 2, size / 2))


def vector(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=F64)


def slots_as_light(size: int = 4) -> Lightmap:
    """Red names the slot."""
    light = torch.zeros(6, 32, size, size, 3)
    light[..., 0] = torch.arange(1.0, 193.0).reshape(6, 32, 1, 1)
    return Lightmap(radiance=light, coverage=torch.ones(6, 32), confidence=torch.ones(6, 32))


@pytest.mark.parametrize(
    ("eye", "orientation"),
    [((5, 0.5, 0.5), 0), ((-4, 0.5, 0.5), 1), ((0.5, 0.5, 5), 4), ((0.5, 0.5, -4), 5)],
)
def test_each_side_shows_its_slot(eye: tuple[float, float, float], orientation: int) -> None:
    renderer = VoxelRenderer(star_probe(1))
    pose = looking_at(vector(*eye), vector(0.5, 0.5, 0.5))
    drawing = renderer.draw(slots_as_light(), camera_rays(camera()), pose)
    assert drawing.alpha[32, 32] == 1
    assert float(drawing.radiance[32, 32, 0]) == pytest.approx(32 * orientation + 1)
    assert (drawing.alpha[[0, -1]] == 0).all()


def test_silhouette_has_the_size_of_the_face() -> None:
    """A unit square 4 units off at 120 px is 30 x 30 px."""
    pose = looking_at(vector(0.5, 0.5, 5), vector(0.5, 0.5, 0.5))
    rays = camera_rays(camera(), samples=4)
    drawing = VoxelRenderer(star_probe(1)).draw(slots_as_light(), rays, pose)
    assert float(drawing.alpha.sum()) == pytest.approx(900, rel=0.01)


def test_light_linear_on_a_face_is_drawn_exactly() -> None:
    """Bilinear interpolation reproduces it, against the rays' meeting points worked out by hand."""
    n = 16
    centre = (torch.arange(n, dtype=torch.float32) + 0.5) / n
    light = torch.zeros(6, 32, n, n, 3)
    light[..., 0] = centre  # from left to right
    light[..., 1] = centre[:, None]  # from forward to backward
    lightmap = Lightmap(radiance=light, coverage=torch.ones(6, 32), confidence=torch.ones(6, 32))
    pose = looking_at(vector(0.5, 0.5, 5), vector(0.5, 0.5, 0.5))
    drawing = VoxelRenderer(star_probe(1)).draw(lightmap, camera_rays(camera()), pose)
    inner = slice(32 - 13, 32 + 13)  # within the centres of the outermost texels
    x = (torch.arange(64) + 0.5 - 32) / 120 * 4 + 0.5
    expected = x[inner].float()[None].expand(26, 26)
    torch.testing.assert_close(drawing.radiance[inner, inner, 0], expected, atol=1e-5, rtol=0)
    # forward is up on this side, and rows run down
    torch.testing.assert_close(drawing.radiance[inner, inner, 1], expected.T, atol=1e-5, rtol=0)


def test_placing_the_model_is_placing_the_camera() -> None:
    """A model moved, turned and scaled, seen by a camera that moved with it."""
    turn = looking_at(vector(1, 2, 3), vector(0, 0, 0)).rotation
    to_world = torch.eye(4, dtype=F64)
    to_world[:3, :3] = 7 * turn
    to_world[:3, 3] = vector(3, -2, 5)
    pose = looking_at(vector(6, 5, 4), vector(1.5, 1.5, 1.5))
    rays = camera_rays(camera(focal=200.0))
    still = VoxelRenderer(star_probe(3)).draw(slots_as_light(), rays, pose)
    moved = VoxelRenderer(star_probe(3), to_world).draw(
        slots_as_light(),
        rays,
        RigidTransform(
            rotation=pose.rotation @ turn.T,
            translation=7 * pose.translation - pose.rotation @ turn.T @ to_world[:3, 3],
        ),
    )  # fmt: skip
    assert float((still.alpha != moved.alpha).double().mean()) < 0.002
    same = (still.alpha == 1) & (moved.alpha == 1)
    differ = (still.radiance[same] - moved.radiance[same]).abs().amax(1) > 1e-3
    assert float(differ.double().mean()) < 0.01
    assert same.sum() > 500


def test_nothing_is_seen_outside_of_the_window() -> None:
    """Near, far and half outside of a strongly distorted picture."""
    lens = Intrinsics(width=96, height=72, fx=80.0, fy=81.0, cx=50.0, cy=33.0, k1=-0.2, k2=0.03)
    renderer = VoxelRenderer(star_probe(5))
    rays = lens_rays(lens)
    shares = []
    for target in ((2.5, 2.5, 2.5), (6.0, 2.5, 2.5), (2.5, 9.0, 2.5), (40.0, 2.5, 2.5)):
        for distance in (5.0, 15.0, 60.0):
            eye = vector(*target) + distance * vector(0.2, 0.4, 0.89)
            pose = looking_at(eye, vector(*target))
            window = renderer.window(pose, lens)
            whole = renderer.draw(slots_as_light(), rays, pose)
            part = renderer.draw(slots_as_light(), lens_rays(lens, 1, window), pose)
            torch.testing.assert_close(part.radiance, whole.radiance[window])
            assert float(whole.alpha.sum()) == float(part.alpha.sum())
            shares.append(part.alpha.numel() / whole.alpha.numel())
    assert min(shares) < 0.1
    assert max(shares) == 1


def test_edges_that_distortion_bends_stay_in_the_window() -> None:
    """A wide solid near a strong barrel distortion: corners alone would cut thousands of pixels."""
    lens = Intrinsics(
        width=640, height=480, fx=480.0, fy=480.0, cx=320.0, cy=240.0, k1=-0.25, k2=0.05
    )
    solid = VoxelModel(occupied=np.ones((10, 10, 10), bool))
    renderer = VoxelRenderer(solid)
    eye, target = vector(5, 5, 10 + 13), vector(5, 5, 5)
    pose = looking_at(eye, target)
    rows, columns = renderer.window(pose, lens)
    whole = renderer.draw(slots_as_light(), lens_rays(lens), pose).alpha
    whole[rows, columns] = 0
    assert float(whole.sum()) == 0
    assert rows.stop - rows.start < 480


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
