"""Two views of a ball: the turn between them, and the camera gone."""

import math

import numpy as np
import pytest
import torch

from skylight.probes.mirror_balls._merged import (
    Turn,
    blend,
    camera_distance_deg,
    match_views,
    unwrap,
)
from skylight.sphere._frame import DirectionGrid, angle_between, rotation_about
from tests.probes.mirror_balls.conftest import Made, made_light, map_of, picture_of, view_of

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
