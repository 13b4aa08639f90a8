"""Rays through cameras, and cameras that look at things."""

import math

import pytest
import torch

from skylight.probes.capture.drawing import camera_rays, looking_at
from skylight.transport.camera import Camera

F64 = torch.float64


def vector(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=F64)


@pytest.mark.parametrize("y", [10.0, -10.0])
def test_cameras_may_look_straight_up_and_down(y: float) -> None:
    rotation, translation = looking_at(vector(1, y, 2), vector(1, 0, 2))
    torch.testing.assert_close(rotation @ rotation.T, torch.eye(3, dtype=F64))
    torch.testing.assert_close(rotation @ vector(1, 0, 2) + translation, vector(0, 0, -10))


CAMERA = Camera(focal_px=120.0, width=8, height=8, center_px=(4.0, 4.0))


def test_rays_of_one_pixel_average_to_it() -> None:
    rays = camera_rays(CAMERA, samples=3)
    assert rays.shape == (8, 8, 9, 3)
    middle = rays[..., 4, :]
    torch.testing.assert_close(middle, camera_rays(CAMERA)[..., 0, :])
    assert float(rays.norm(dim=-1).sub(1).abs().max()) < 1e-12


def test_camera_looks_where_it_should() -> None:
    rotation, translation = looking_at(vector(1, 2, 3), vector(0, 0, 0))
    seen = rotation @ vector(0, 0, 0) + translation
    torch.testing.assert_close(seen, vector(0, 0, -math.sqrt(14)))
    assert torch.det(rotation) == pytest.approx(1)
    assert (rotation @ vector(0, 1, 0))[1] > 0
