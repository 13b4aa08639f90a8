import torch

from skylight.transport._cameras import Camera

CAMERA = Camera(focal_px=120.0, width=64, height=48, center_px=(30.0, 25.0))


def test_rays_and_projection_are_inverse():
    rays = CAMERA.rays()
    row, column = torch.meshgrid(torch.arange(48), torch.arange(64), indexing="ij")
    centres = torch.stack([column, row], dim=-1).reshape(-1, 2) + 0.5
    torch.testing.assert_close(CAMERA.project(3.7 * rays), centres.double())
    torch.testing.assert_close(rays.norm(dim=1), torch.ones(48 * 64, dtype=torch.float64))


def test_right_is_plus_x_and_up_is_a_smaller_row():
    points = torch.tensor([[0.0, 0, -2], [0.5, 0, -2], [0, 0.5, -2]])
    centre, right, up = CAMERA.project(points)
    assert centre.tolist() == [30, 25]
    assert right.tolist() == [60, 25]
    assert up.tolist() == [30, -5]
