"""Mitsuba's pictures against ours: silhouettes, albedo, and which way up paint is."""

import numpy as np
import pytest
import torch

from skylight.probes.cameras._drawing import camera_rays, looking_at
from skylight.probes.voxel._model import exposed_faces, star_probe
from skylight.sphere._envmap import EnvironmentMap
from skylight.transport._cameras import Camera
from skylight.transport._rays import Raycaster

pytest.importorskip("mitsuba", reason="mitsuba is not installed")

from skylight.people._independent_render import IndependentScene, Solid, SphereLamp, as_photo

CAMERA = Camera(focal_px=120.0, width=64, height=48, center_px=(29.0, 27.0))


def vector(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_a_cube_in_a_white_world_has_its_albedo_where_our_rays_meet_it() -> None:
    vertices, triangles = exposed_faces(star_probe(1)).triangles()
    solid = Solid(vertices=vertices.numpy(), triangles=triangles.numpy(), albedo=0.5)
    white = EnvironmentMap(radiance=torch.ones(8, 16, 3))
    pose = looking_at(vector(2, 3, 4), vector(0.5, 0.5, 0.5))
    picture = IndependentScene([solid], white).radiance(
        CAMERA, pose.rotation.numpy(), pose.translation.numpy(), samples=16
    )
    rays = camera_rays(CAMERA).reshape(-1, 3) @ pose.rotation
    eye = pose.inverse().translation.expand(len(rays), 3)
    ours = (Raycaster(vertices, triangles).intersect(eye, rays).face >= 0).reshape(48, 64).numpy()
    theirs = picture.mean(-1) < 0.75
    assert 150 < ours.sum() < 1500
    assert (ours != theirs).sum() < 0.1 * ours.sum() ** 0.5 * 12  # along the outline
    np.testing.assert_allclose(picture[ours & theirs].mean(), 0.5, atol=0.02)
    np.testing.assert_allclose(np.median(picture[~ours]), 1.0, atol=1e-3)


def test_a_sphere_lamp_lights_as_its_distance_says() -> None:
    """E = pi L (r / d)^2 where it stands overhead, so albedo L (r / d)^2 leaves a small square."""
    square = Solid(
        vertices=0.01 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]),
        triangles=np.array([[0, 1, 2], [0, 2, 3]]),
        albedo=0.5,
    )
    pose = looking_at(vector(0.0, 0.02, 0.02), vector(0, 0, 0))
    for distance, radius in ((1.0, 0.1), (3.0, 0.5)):
        lamp = SphereLamp(centre=np.array([0, 0, distance]), radius=radius, radiance=40.0)
        picture = IndependentScene([square], lamp).radiance(
            CAMERA, pose.rotation.numpy(), pose.translation.numpy(), samples=64
        )
        expected = 0.5 * 40 * (radius / distance) ** 2
        np.testing.assert_allclose(picture[22:32, 24:34].mean(), expected, rtol=0.01)


def test_row_0_of_paint_is_at_v_1() -> None:
    """A square seen straight on: red above, green below, black left of its middle."""
    paint = np.zeros((2, 2, 3))
    paint[0, 1], paint[1, 1] = (0.8, 0, 0), (0, 0.8, 0)
    square = Solid(
        vertices=np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]),
        triangles=np.array([[0, 1, 2], [0, 2, 3]]),
        paint=paint.repeat(64, 0).repeat(64, 1),
        uv=np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]),
    )
    white = EnvironmentMap(radiance=torch.ones(8, 16, 3))
    pose = looking_at(vector(0, 0, 4), vector(0, 0, 0))
    picture = IndependentScene([square], white).radiance(
        CAMERA, pose.rotation.numpy(), pose.translation.numpy(), samples=64
    )
    # the square is 60 pixels wide about (29, 27)
    np.testing.assert_allclose(picture[14, 44], [0.8, 0, 0], atol=0.05)
    np.testing.assert_allclose(picture[40, 44], [0, 0.8, 0], atol=0.05)
    np.testing.assert_allclose(picture[14, 14], 0, atol=0.01)


def test_photos_are_exposed_encoded_and_clipped() -> None:
    linear = np.full((20, 20, 3), 0.25, dtype=np.float32)
    codes = as_photo(linear, exposure=2.0, noise=1.0, seed=0)
    assert abs(codes.mean() - 187.5) < 0.2
    assert 0.8 < codes.std() < 1.3
    assert (as_photo(linear, exposure=9.0, noise=0.0, seed=0) == 255).all()
