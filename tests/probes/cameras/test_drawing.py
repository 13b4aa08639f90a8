"""Rays through cameras, and cameras that look at things."""

import math

import numpy as np
import pytest
import torch

from skylight.probes.cameras._drawing import (
    box_edges,
    camera_rays,
    is_empty,
    lens_rays,
    looking_at,
    window_of,
)
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.sphere._rotation import RigidTransform
from skylight.transport._cameras import Camera

F64 = torch.float64


def vector(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=F64)


@pytest.mark.parametrize("y", [10.0, -10.0])
def test_cameras_may_look_straight_up_and_down(y: float) -> None:
    pose = looking_at(vector(1, y, 2), vector(1, 0, 2))
    torch.testing.assert_close(pose.points(vector(1, 0, 2)), vector(0, 0, -10))


CAMERA = Camera(focal_px=120.0, width=8, height=8, center_px=(4.0, 4.0))


def test_rays_of_one_pixel_average_to_it() -> None:
    rays = camera_rays(CAMERA, samples=3)
    assert rays.shape == (8, 8, 9, 3)
    middle = rays[..., 4, :]
    torch.testing.assert_close(middle, camera_rays(CAMERA)[..., 0, :])
    assert float(rays.norm(dim=-1).sub(1).abs().max()) < 1e-12


def test_camera_looks_where_it_should() -> None:
    pose = looking_at(vector(1, 2, 3), vector(0, 0, 0))
    seen = pose.points(vector(0, 0, 0))
    torch.testing.assert_close(seen, vector(0, 0, -math.sqrt(14)))
    assert pose.directions(vector(0, 1, 0))[1] > 0


LENS = Intrinsics(width=96, height=72, fx=80.0, fy=81.0, cx=50.0, cy=33.0, k1=-0.2, k2=0.03)
STILL = RigidTransform.identity()


def box_at(x: float, y: float, z: float, half: float = 1.0) -> np.ndarray:
    middle = vector(x, y, z)
    return box_edges(middle - half, middle + half).numpy()


@pytest.mark.parametrize(
    "place",
    [(40, 0, -10), (-40, 0, -10), (0, 40, -10), (0, -40, -10), (900, 0, -1), (0, 0, 30), (9, 0, 0)],
)
def test_what_is_beyond_an_edge_has_no_window(place: tuple[float, float, float]) -> None:
    """However far, and also where it begins beside the camera and ends behind it."""
    assert is_empty(window_of(box_at(*place), STILL, LENS))


def test_what_only_may_be_outside_has_a_window() -> None:
    around = box_at(0, 0, 0, half=50.0)  # the camera is in it
    assert window_of(around, STILL, LENS) == (slice(0, 72), slice(0, 96))
    wide = box_edges(vector(-500, -1, -12), vector(500, 1, -10)).numpy()
    assert not is_empty(window_of(wide, STILL, LENS))


def test_windows_are_empty_only_where_no_ray_meets_the_box() -> None:
    rays = lens_rays(LENS)[:, :, 0].reshape(-1, 3).numpy()
    empty = 0
    for x in np.linspace(-12, 12, 49):
        box = box_at(float(x), 0.4 * float(x), -9.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            near, far = box.min(0) / rays, box.max(0) / rays
        enter, leave = np.minimum(near, far).max(1), np.maximum(near, far).min(1)
        if is_empty(window_of(box, STILL, LENS)):
            empty += 1
            assert not (enter < leave).any()
    assert 5 < empty < 40
