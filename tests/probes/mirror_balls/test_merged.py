"""Balls unwrapped, and two views of one blended."""

import math

import numpy as np
import pytest
import torch

from skylight.probes.mirror_balls._ball import ball_of_circle, picture_camera
from skylight.probes.mirror_balls._merged import (
    BallView,
    Turn,
    blend,
    camera_distance_deg,
    match_views,
    unwrap,
)
from skylight.sphere._frame import DirectionGrid, angle_between, rotation_about
from tests.probes.mirror_balls.conftest import (
    SIZE,
    Made,
    made_light,
    map_of,
    picture_of,
    true_ball,
    view_of,
)


def axis_colours(w: np.ndarray) -> np.ndarray:
    """Red towards +X, green towards +Y, blue towards +Z; 0.5 across."""
    return 0.5 + 0.5 * w


class TestUnwrap:
    def test_light_is_found_again(self, made: Made) -> None:
        probe = unwrap(view_of(made.picture), 32)
        seen = probe.seen.numpy() > 0.999
        got, want = probe.environment.radiance.numpy(), made.radiance.numpy()
        error = np.abs(got - want).mean(-1) / want.mean(-1)
        assert np.median(error[seen]) < 0.01
        assert np.quantile(error[seen], 0.95) < 0.12  # at edges, and in the squeezed rim
        weight = (probe.environment.grid.solid_angles.numpy().reshape(32, 64) * seen)[..., None]
        assert (got * weight).sum() == pytest.approx((want * weight).sum(), rel=0.01)

    def test_the_right_way_round(self) -> None:
        probe = unwrap(view_of(picture_of(axis_colours)), 32)
        seen = probe.seen.numpy() > 0.999
        error = np.abs(probe.environment.radiance.numpy() - map_of(axis_colours, 32).numpy())
        assert error[seen].max() < 0.02
        rows, columns = probe.environment.layout
        right = probe.environment.radiance[rows // 2, 3 * columns // 4]
        assert float(right[0]) > 0.99  # +X a quarter turn to the right
        assert float(probe.environment.radiance[0, 0, 1]) > 0.97  # +Y on top
        assert float(probe.environment.radiance[rows // 2, 0, 2]) > 0.97  # the camera's side

    def test_the_blind_cone_is_the_shadow_of_the_ball(self, made: Made) -> None:
        view = view_of(made.picture)
        ball = view.ball
        # 1.5 px within the outline a ray at b to the axis meets the ball and leaves at psi
        b = math.atan(math.tan(ball.half_angle_rad) * (1 - 1.5 / ball.circle[2]))
        psi = 2 * math.asin(ball.distance * math.sin(b)) - b
        assert unwrap(view, 32).unseen_share == pytest.approx((1 + math.cos(psi)) / 2, abs=2e-3)

    def test_parallel_rays_follow_the_half_angle(self) -> None:
        """Orthographic: light from psi off the camera's side is seen at radius sin(psi / 2)."""
        ball = ball_of_circle(picture_camera(*SIZE, None), 150.0, 120.0, 100.0)
        mask = torch.zeros(SIZE, dtype=torch.bool)
        view = BallView(radiance=torch.zeros(*SIZE, 3), clipped=mask, ball=ball)
        psi = torch.tensor([0.0, 0.3, 1.0, 2.0], dtype=torch.float64)
        directions = torch.stack([torch.sin(psi), 0 * psi, torch.cos(psi)], -1)
        places, seen = view.places(directions)
        assert seen.all()
        np.testing.assert_allclose(places[:, 0], 150 + 100 * np.sin(psi.numpy() / 2), atol=0.1)
        np.testing.assert_allclose(places[:, 1], 120, atol=0.1)

    def test_reflectivity_divides(self, made: Made) -> None:
        bright = unwrap(view_of(made.picture), 16).environment.radiance
        view = view_of(0.6 * made.picture)
        half = BallView(
            radiance=view.radiance, clipped=view.clipped, ball=view.ball, reflectivity=0.6
        )
        torch.testing.assert_close(unwrap(half, 16).environment.radiance, bright)

    def test_too_short_a_lens_is_told_by_what_comes_out(self, made: Made) -> None:
        """That the camera is near counts: parallel rays put things degrees away."""
        view = view_of(made.picture)
        circle = true_ball().circle
        far = BallView(
            radiance=view.radiance,
            clipped=view.clipped,
            ball=ball_of_circle(picture_camera(*SIZE, None), *circle),
        )
        right = torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64)
        apart = np.linalg.norm(view.places(right)[0] - far.places(right)[0])
        assert apart > 0.03 * circle[2]


UP = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
RIGHT = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
PERSON = np.array([0.02, 0.01, 0.5])


def turned(azimuth_deg: float, tilt_deg: float = 0.0) -> np.ndarray:
    """The frame of a camera that looks ``azimuth_deg`` to the right, then ``tilt_deg`` up."""
    turn = rotation_about(UP, -math.radians(azimuth_deg))
    return (turn @ rotation_about(RIGHT, math.radians(tilt_deg))).numpy()


def picture_with_person(turn: np.ndarray) -> np.ndarray:
    """Somebody 12 degrees wide stands behind the camera."""
    behind = turn @ np.array([0.0, 0.0, 1.0])

    def light(w: np.ndarray) -> np.ndarray:
        colour = made_light(w)
        colour[w @ behind > math.cos(math.radians(12.0))] = PERSON
        return colour

    return picture_of(light, turn)


@pytest.fixture(scope="module")
def pictures() -> tuple[np.ndarray, np.ndarray]:
    return picture_with_person(np.eye(3)), picture_with_person(turned(84.0, 4.0))


def error_deg(turn: Turn, want: np.ndarray) -> float:
    trace = float(np.trace(turn.rotation.numpy().T @ want))
    return math.degrees(math.acos(min(1.0, (trace - 1) / 2)))


class TestMatch:
    @pytest.mark.parametrize("stated", [90.0, -90.0])
    def test_turn_tilt_and_brightness_are_found(
        self, pictures: tuple[np.ndarray, np.ndarray], stated: float
    ) -> None:
        first, second = view_of(pictures[0]), view_of(0.8 * pictures[1])
        turn = match_views(first, second, stated)
        assert turn.correlation is not None
        assert turn.correlation > 0.9
        assert turn.azimuth_deg == pytest.approx(84.0, abs=0.7)
        assert error_deg(turn, turned(84.0, 4.0)) < 0.7
        assert turn.gain == pytest.approx(1 / 0.8, rel=0.02)

    def test_views_of_different_places_are_taken_at_their_word(self, made: Made) -> None:
        noise = np.random.default_rng(0).uniform(0.2, 1.0, made.picture.shape)
        turn = match_views(view_of(made.picture), view_of(noise), 70.0)
        assert turn.correlation is None
        assert (turn.azimuth_deg, turn.gain) == (70.0, 1.0)
        assert camera_distance_deg(turn) == pytest.approx(70.0)
        assert error_deg(turn, turned(70.0)) < 1e-4


class TestBlend:
    def test_the_photographer_is_gone(self, pictures: tuple[np.ndarray, np.ndarray]) -> None:
        first, second = (view_of(picture) for picture in pictures)
        turn = match_views(first, second)
        both, alone = blend(first, second, turn, 32), unwrap(first, 32)
        want = map_of(made_light, 32).numpy()
        directions = DirectionGrid.latlong(32).directions
        frames = (np.eye(3), turned(84.0, 4.0))
        for frame in frames:
            for place in (frame[:, 2], -frame[:, 2]):  # behind the camera, behind the ball
                near = angle_between(directions, torch.from_numpy(place).expand_as(directions))
                inside = (near < math.radians(11.0)).numpy().reshape(32, 64)
                off = np.abs(both.environment.radiance.numpy() - want)[inside] / want[inside]
                assert np.median(off) < 0.05
        person = (directions @ torch.from_numpy(frames[0][:, 2]) > 0.99).numpy().reshape(32, 64)
        there = np.abs(alone.environment.radiance.numpy() - PERSON)[person]
        assert there.max() < 0.01
        assert both.unseen_share == 0
        error = np.abs(both.environment.radiance.numpy() - want).mean(-1) / want.mean(-1)
        assert np.median(error) < 0.015
