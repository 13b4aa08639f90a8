"""A ball in a picture: cones of rays, and outlines found."""

import math

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.probes.mirror_balls._ball import (
    ball_of_circle,
    distances_px,
    find_ball,
    fit_ball,
    focal_from_fov,
    picture_camera,
)
from tests.probes.mirror_balls.conftest import FOCAL_PX, MIDDLE, SIZE, Made, true_ball


class TestBall:
    def test_outlines_of_balls_off_the_axis_are_ellipses_that_fit_exactly(self) -> None:
        ball = true_ball((250.0, 60.0), 9.0)
        points = ball.outline(90)
        radii = np.linalg.norm(points - points.mean(0), axis=1)
        assert np.ptp(radii) > 1.0
        found = fit_ball(ball.camera, points)
        np.testing.assert_allclose(found.axis, ball.axis, atol=1e-9)
        assert found.half_angle_rad == pytest.approx(ball.half_angle_rad, rel=1e-9)

    def test_parallel_rays_give_the_circle_back(self) -> None:
        camera = picture_camera(*SIZE, None)
        ball = ball_of_circle(camera, 130.0, 100.0, 70.0)
        assert ball.circle == pytest.approx((130.0, 100.0, 70.0), abs=1e-3)
        assert math.degrees(ball.half_angle_rad) < 0.05

    def test_distances_are_from_the_outline(self) -> None:
        ball = true_ball()
        points = ball.outline(60)
        outward = points - points.mean(0)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        for step in (-1.0, 0.0, 2.0):
            # to first order, and radii are not quite normals of an ellipse
            got = distances_px(ball, points + step * outward)
            np.testing.assert_allclose(got, step, atol=0.04)

    def test_circles_out_of_the_picture_are_refused(self) -> None:
        camera = picture_camera(*SIZE, FOCAL_PX)
        with pytest.raises(InputError, match=r"20 px .* 300x240"):
            ball_of_circle(camera, 30.0, 100.0, 50.0)
        with pytest.raises(InputError, match="16 px"):
            ball_of_circle(camera, 150.0, 100.0, 5.0)

    def test_fields_of_view(self) -> None:
        assert focal_from_fov(200, 90.0) == pytest.approx(100.0)
        with pytest.raises(InputError, match="field of view"):
            focal_from_fov(200, 0.0)


class TestFindBall:
    def test_within_a_pixel(self, made: Made) -> None:
        noise = 1 + 0.02 * np.random.default_rng(0).standard_normal(made.picture.shape)
        picture = torch.from_numpy((made.picture * noise).astype(np.float32))
        found = find_ball(picture, picture_camera(*SIZE, FOCAL_PX))
        true = true_ball()
        assert np.abs(np.array(found.ball.circle) - true.circle).max() < 1.0
        assert np.abs(distances_px(true, found.ball.outline())).max() < 1.0
        assert found.support is not None
        assert found.support > 0.6

    def test_in_a_picture_turned_upside_down(self, made: Made) -> None:
        picture = torch.from_numpy(made.picture[::-1, ::-1].astype(np.float32).copy())
        found = find_ball(picture, picture_camera(*SIZE, FOCAL_PX))
        x, y, _ = found.ball.circle
        assert (x, y) == pytest.approx((SIZE[1] - MIDDLE[0], SIZE[0] - MIDDLE[1]), abs=1.5)

    def test_no_ball(self) -> None:
        picture = torch.from_numpy(np.random.default_rng(0).uniform(0.4, 0.6, (*SIZE, 3)))
        with pytest.raises(InputError, match="outline"):
            find_ball(picture.float(), picture_camera(*SIZE, FOCAL_PX))
