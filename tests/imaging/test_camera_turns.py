"""Turns of the camera against known rotations."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skylight.imaging._camera_turns import (
    BackgroundCorners,
    Link,
    focal_from_turns,
    turn_between,
    world_from_cameras,
)

SIZE, FOCAL = (640, 480), 900.0


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(Rotation.from_matrix(a.T @ b).magnitude()))


def seen(directions: np.ndarray, world_from_camera: np.ndarray, focal: float) -> np.ndarray:
    x, y, z = world_from_camera.T @ directions.T
    return np.stack([SIZE[0] / 2 - focal * x / z, SIZE[1] / 2 + focal * y / z], 1)


def scattered(rng: np.random.Generator, count: int) -> np.ndarray:
    """Directions about -Z, within the picture of a camera that is hardly turned."""
    places = rng.uniform([-300, -220], [300, 220], (count, 2))
    rays = np.concatenate([places, np.full((count, 1), -FOCAL)], 1)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def matches(
    rng: np.random.Generator, turn: np.ndarray, *, count: int = 150, outliers: float = 0.0
) -> Link:
    directions = scattered(rng, count)
    before = seen(directions, np.eye(3), FOCAL) + rng.normal(0, 0.2, (count, 2))
    after = seen(directions, turn, FOCAL) + rng.normal(0, 0.2, (count, 2))
    wrong = rng.random(count) < outliers
    after[wrong] += rng.uniform(-60, 60, (int(wrong.sum()), 2))
    return Link(start=0, end=1, before=before, after=after)


class TestTurns:
    @pytest.mark.parametrize("outliers", [0.0, 0.45])
    def test_a_known_turn_is_found(self, outliers: float) -> None:
        rng = np.random.default_rng(1)
        turn = Rotation.from_euler("yxz", [7, -3, 2], degrees=True).as_matrix()
        found = turn_between(matches(rng, turn, outliers=outliers), FOCAL, SIZE)
        assert found is not None
        assert angle_deg(found, turn) < 0.03

    def test_without_noise_it_is_exact(self) -> None:
        directions = scattered(np.random.default_rng(2), 40)
        turn = Rotation.from_euler("yxz", [12, 5, -8], degrees=True).as_matrix()
        before, after = seen(directions, np.eye(3), FOCAL), seen(directions, turn, FOCAL)
        found = turn_between(Link(start=0, end=1, before=before, after=after), FOCAL, SIZE)
        assert found is not None
        assert angle_deg(found, turn) < 1e-6

    def test_turns_are_chained(self) -> None:
        rng = np.random.default_rng(3)
        steps = [
            Rotation.from_euler("yx", angles, degrees=True).as_matrix()
            for angles in ([5, 1], [6, -2], [-3, 4])
        ]
        links = [
            Link(start=k, end=k + 1, before=one.before, after=one.after)
            for k, one in enumerate(matches(rng, step) for step in steps)
        ]
        world, untold = world_from_cameras(links, FOCAL, SIZE)
        assert untold == []
        assert angle_deg(world[3], steps[0] @ steps[1] @ steps[2]) < 0.1
        np.testing.assert_array_equal(world[0], np.eye(3))

    def test_what_moves_at_random_tells_no_turn(self) -> None:
        rng = np.random.default_rng(4)
        before, after = rng.uniform(0, 480, (2, 100, 2))
        link = Link(start=0, end=5, before=before, after=after)
        assert turn_between(link, FOCAL, SIZE) is None
        few = Link(start=0, end=5, before=before[:5], after=before[:5])
        assert turn_between(few, FOCAL, SIZE) is None
        world, untold = world_from_cameras([link], FOCAL, SIZE)
        assert untold == [link]
        np.testing.assert_array_equal(world[5], np.eye(3))


class TestFocalLength:
    def test_wide_turns_tell_it(self) -> None:
        rng = np.random.default_rng(5)
        turns = [Rotation.from_euler("yx", a, degrees=True).as_matrix() for a in ([9, 2], [-8, 5])]
        links = [matches(rng, turn, outliers=0.2) for turn in turns]
        focal, spread = focal_from_turns(links, 1.4 * FOCAL, 0.3, SIZE)
        assert focal == pytest.approx(FOCAL, rel=0.02)
        assert spread < 0.05

    def test_a_still_camera_leaves_the_guess(self) -> None:
        links = [matches(np.random.default_rng(6), np.eye(3))]
        focal, spread = focal_from_turns(links, 1234.0, 0.3, SIZE)
        assert focal == pytest.approx(1234, rel=0.05)
        assert spread > 0.2
        assert focal_from_turns([], 1234.0, 0.3, SIZE) == pytest.approx((1234, 0.3))


def panorama() -> np.ndarray:
    """A textured backdrop, 12 px a degree, 90 x 60 degrees, whose middle is straight ahead."""
    rng = np.random.default_rng(7)
    out = np.zeros((720, 1080, 3), np.float32)
    for side in (12, 40, 120):
        coarse = rng.uniform(-1, 1, (720 // side + 2, 1080 // side + 2, 3)).astype(np.float32)
        out += cv2.resize(coarse, (1080, 720), interpolation=cv2.INTER_CUBIC)
    return (127 + 50 * out).clip(0, 255).astype(np.uint8)


def photographed(backdrop: np.ndarray, world_from_camera: np.ndarray, head_x: int) -> np.ndarray:
    """The backdrop from a turned camera, and a textured head before it that moves on its own."""
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]] + 0.5
    rays = np.stack([x - SIZE[0] / 2, SIZE[1] / 2 - y, np.full_like(x, -FOCAL)], 2)
    rays = rays @ world_from_camera.T
    azimuth = np.degrees(np.arctan2(rays[..., 0], -rays[..., 2]))
    height = np.degrees(np.arcsin(rays[..., 1] / np.linalg.norm(rays, axis=2)))
    column, row = 540 + 12 * azimuth - 0.5, 360 - 12 * height - 0.5
    picture = cv2.remap(
        backdrop, column.astype(np.float32), row.astype(np.float32), cv2.INTER_CUBIC
    )
    head = np.random.default_rng(8).integers(0, 255, (25, 20, 3)).astype(np.uint8)
    head = cv2.resize(head, (200, 250), interpolation=cv2.INTER_CUBIC)
    picture[120:370, head_x : head_x + 200] = head
    return picture


def test_a_camera_that_pans_behind_a_head_that_moves() -> None:
    backdrop, corners = panorama(), BackgroundCorners(*SIZE)
    links, anchor = [], 0
    for frame in range(13):
        turn = Rotation.from_euler("yx", [-1.5 * frame, 0.4 * frame], degrees=True).as_matrix()
        head_x = 200 + 5 * frame
        codes = photographed(backdrop, turn, head_x)
        background = np.ones((SIZE[1], SIZE[0]), bool)
        background[100:, head_x - 20 : head_x + 220] = False
        if frame == 0:
            corners.anchor(codes, background)
            continue
        assert corners.follow(codes, background) > 0.5
        if corners.is_worn or frame == 12:
            links.append(corners.link(anchor, frame))
            corners.anchor(codes, background)
            anchor = frame
    assert len(links) > 1
    world, untold = world_from_cameras(links, FOCAL, SIZE)
    assert untold == []
    assert angle_deg(world[12], turn) < 0.3
    assert focal_from_turns(links, 1.3 * FOCAL, 0.3, SIZE)[0] == pytest.approx(FOCAL, rel=0.05)


def test_a_plain_wall_has_no_corners() -> None:
    wall = np.full((SIZE[1], SIZE[0], 3), 120, np.uint8)
    everywhere = np.ones((SIZE[1], SIZE[0]), bool)
    corners = BackgroundCorners(*SIZE)
    corners.anchor(wall, everywhere)
    assert corners.follow(wall, everywhere) == 0
    assert corners.is_worn
    assert turn_between(corners.link(0, 1), FOCAL, SIZE) is None
