"""Scenes drawn: interpolation between vertices, textures, and what stands before them."""

import numpy as np
import pytest
import torch

from skylight.probes.cameras._drawing import camera_rays, lens_rays, looking_at, window_of
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.partitions.relight._composite import SceneRenderer
from skylight.probes.partitions.relight._scene import Scene
from skylight.sphere._rotation import RigidTransform
from skylight.transport._cameras import Camera
from tests.probes.partitions.boards import F64, affine, box, turn_about_y
from tests.probes.partitions.shapes import QUAD, quad

CAMERA = Camera(focal_px=120.0, width=64, height=64, center_px=(32.0, 32.0))
LENS = Intrinsics(width=96, height=72, fx=80.0, fy=81.0, cx=50.0, cy=33.0, k1=-0.2)


def vector(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=F64)


def floor(**kind) -> Scene:
    """[-1, 1]^2 in x and z."""
    corners = torch.tensor([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1.0]], dtype=F64)
    return Scene.of(corners, QUAD, torch.tensor([0.5, 0.5, 0.5]), **kind)


def test_light_linear_in_the_place_is_drawn_exactly() -> None:
    """From straight above at 5 units and 120 px, against meeting points worked out by hand."""
    scene = floor()
    pose = looking_at(vector(0, 5, 0), vector(0, 0, 0))
    drawing = SceneRenderer(scene).draw(scene.vertices.float(), camera_rays(CAMERA), pose)
    place = ((torch.arange(64) + 0.5 - 32) / 120 * 5).float()
    inside = place.abs() < 1
    expected = place[inside][None].expand(int(inside.sum()), -1)
    shown = drawing.radiance[inside][:, inside]
    torch.testing.assert_close(shown[..., 0], expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(shown[..., 2], expected.T, atol=1e-5, rtol=0)
    assert float(drawing.alpha.sum()) == pytest.approx(int(inside.sum()) ** 2)


def test_small_triangles_from_afar_are_interpolated_between() -> None:
    """Ratios of volumes in float32, a hundred thousand times smaller than the products."""
    scene = box(1.0)
    eye = vector(300, 400, 500)
    pose = looking_at(eye, vector(0, 0.5, 0))
    far = Camera(focal_px=40_000.0, width=64, height=64, center_px=(32.0, 32.0))
    rays = camera_rays(far)
    drawing = SceneRenderer(scene).draw(scene.vertices.float(), rays, pose)
    directions = rays.reshape(-1, 3) @ pose.rotation
    hits = scene.raycaster.intersect(eye.expand(len(directions), 3), directions)
    points = scene.interpolated(scene.vertices, hits.face, hits.barycentric)
    there = (hits.face >= 0) & (drawing.alpha.flatten() == 1)
    assert int(there.sum()) > 1000
    assert float((drawing.radiance.reshape(-1, 3)[there] - points[there]).abs().max()) < 2e-3


def test_a_texture_reflects_what_falls_between_the_vertices() -> None:
    """A checker of two texels, each as bright as its albedo under even light."""
    texture = torch.tensor([[[0.2, 0.4, 0.6], [0.8, 0.6, 0.1]]])
    uv = torch.tensor([[0, 0], [0, 1], [1, 1], [1, 0]], dtype=F64)
    scene = floor(uv=uv, texture=texture)
    pose = looking_at(vector(0, 5, 0), vector(0, 0, 0))
    drawing = SceneRenderer(scene).draw(3.0 * scene.albedo.float(), camera_rays(CAMERA), pose)
    # the middles of the texels are half way to the sides
    at = round(0.5 / 5 * 120)
    torch.testing.assert_close(
        drawing.radiance[32, [32 - at, 31 + at]], 3 * texture[0], atol=0.08, rtol=0
    )


def test_placing_the_scene_is_placing_the_camera() -> None:
    scene, turn = box(2.0), turn_about_y(0.7)
    moved = scene.placed(affine(7 * turn, (3, -2, 5)))
    light = torch.rand(len(scene.vertices), 3, generator=torch.Generator().manual_seed(0))
    pose = looking_at(vector(4, 5, 6), vector(0, 1, 0))
    still = SceneRenderer(scene).draw(light, camera_rays(CAMERA), pose)
    same = SceneRenderer(moved).draw(
        light,
        camera_rays(CAMERA),
        RigidTransform(
            rotation=pose.rotation @ turn.T,
            translation=7 * pose.translation - pose.rotation @ turn.T @ vector(3, -2, 5),
        ),
    )  # fmt: skip
    differ = (still.radiance - same.radiance).abs().amax(2) > 1e-3
    assert float(differ.double().mean()) < 0.01
    assert float(still.alpha.sum()) > 400


def test_nothing_is_seen_outside_of_the_window() -> None:
    renderer, scene = SceneRenderer(box(2.0)), box(2.0)
    light = scene.vertices.float().abs()
    for target in ((0.0, 1, 0), (4.0, 1, 0), (40.0, 1, 0)):
        eye = vector(*target) + vector(3, 6, 12)
        pose = looking_at(eye, vector(*target))
        window = window_of(renderer.box, pose, LENS)
        whole = renderer.draw(light, lens_rays(LENS), pose)
        part = renderer.draw(light, lens_rays(LENS, 1, window), pose)
        torch.testing.assert_close(part.radiance, whole.radiance[window])
        assert float(whole.alpha.sum()) == float(part.alpha.sum())


def test_a_real_thing_hides_what_is_behind_it() -> None:
    """A sheet before the left half of the scene."""
    scene = box(2.0)
    sheet = quad([-3, -1, 2], [0, -1, 2], [0, 4, 2], [-3, 4, 2])
    real = sheet.vertices.numpy(), sheet.faces.numpy()
    pose = looking_at(vector(0, 1, 12), vector(0, 1, 0))
    ones = torch.ones(len(scene.vertices), 3)
    lens = Intrinsics(width=96, height=72, fx=160.0, fy=160.0, cx=47.5, cy=35.5)
    rays = lens_rays(lens)
    free = SceneRenderer(scene).draw(ones, rays, pose)
    hidden = SceneRenderer(scene, real).draw(ones, rays, pose)
    assert float(free.alpha[:, :48].sum()) > 200
    assert float(hidden.alpha[:, :48].sum()) == 0
    torch.testing.assert_close(hidden.alpha[:, 48:], free.alpha[:, 48:])
    window = slice(10, 60), slice(5, 90)
    seen = SceneRenderer(scene, real).uncovered(window, rays[window], pose, lens)
    columns = np.arange(5, 90)
    # the sheet is 3 units wide, 10 away, at 160 px
    expected = torch.from_numpy(columns >= 48).float()[None].expand(50, -1)
    torch.testing.assert_close(seen, expected)
