"""A board followed through films whose cameras are known."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from skylight.errors import InputError
from skylight.probes.cameras._board import Board
from skylight.probes.cameras._intrinsics import Intrinsics
from skylight.probes.cameras._pose import BoardPose, board_pose, camera_centre, project
from skylight.probes.cameras._tracking import BoardTracker
from skylight.sphere._rotation import RigidTransform
from tests.probes.cameras.scenes import board_from_tilt, picture_of_board
from tests.probes.cameras.test_pose import true_pose

BOARD = Board(columns=8, rows=6, square_mm=30.0, marker_mm=21.0)
CORNERS = 35
LENS = Intrinsics(
    width=640, height=480, fx=560.0, fy=563.0, cx=315.0, cy=243.0, k1=-0.12, k2=0.08, p1=8e-4,
)  # fmt: skip
View = tuple[float, float, float, list[float]]


def moving(frame: int) -> View:
    """A camera that turns by 3.4 degrees a frame, and by 0.6 to and fro; 90 degrees a second."""
    jitter = 0.6 * (-1) ** frame
    return 25 + jitter, -18 + 2 * frame, 2 * frame - jitter, [3 * frame, 10, 520 - 2 * frame]


def picture(view: View, seed: int = 0) -> np.ndarray:
    return picture_of_board(BOARD, LENS, *board_from_tilt(BOARD, *view), seed=seed)


@cache
def film() -> list[np.ndarray]:
    return [picture(moving(i), seed=i) for i in range(10)]


def off(found: BoardPose, truth: RigidTransform) -> tuple[float, float]:
    """(degrees, mm of the camera's place)."""
    apart = camera_centre(found.pose) - camera_centre(truth)
    return float((found.pose @ truth.inverse()).angle_deg), float(np.linalg.norm(apart))


def follow(tracker: BoardTracker, images: list[np.ndarray]) -> list[BoardPose]:
    found = [tracker.pose(image) for image in images]
    assert all(found)
    return [each for each in found if each is not None]


def test_poses_are_as_good_as_those_of_whole_frames() -> None:
    tracker = BoardTracker(BOARD, LENS)
    found = follow(tracker, film())
    assert tracker.searched == 1
    errors = np.array([off(each, true_pose(BOARD, moving(i))) for i, each in enumerate(found)])
    assert errors[:, 0].max() < 0.15
    assert errors[:, 1].max() < 1.3  # 0.15 degrees at 50 cm
    for each, image in list(zip(found, film(), strict=True))[::4]:
        whole = board_pose(image, BOARD, LENS)
        assert whole is not None
        turn, shift = off(each, whole.pose)
        assert turn < 0.2
        assert shift < 1.7
        assert each.corners == CORNERS
        assert each.rms_px < whole.rms_px + 0.05


def test_a_still_view_does_not_drift() -> None:
    """Corners come from each frame itself: as often as it is shown, a frame has one pose."""
    tracker = BoardTracker(BOARD, LENS)
    first, *others = follow(tracker, film()[:1] * 8)
    turn, shift = off(others[-1], first.pose)
    assert turn < 0.01
    assert shift < 0.1
    assert tracker.searched == 1


def test_a_lost_board_is_found_again() -> None:
    tracker = BoardTracker(BOARD, LENS)
    blank = np.full((480, 640, 3), 120, dtype=np.uint8)
    follow(tracker, film()[:2])
    assert tracker.pose(blank) is None
    assert tracker.pose(blank) is None
    assert tracker.searched == 3
    (back,) = follow(tracker, film()[4:5])
    assert off(back, true_pose(BOARD, moving(4)))[0] < 0.15
    follow(tracker, film()[5:7])
    assert tracker.searched == 4


@pytest.mark.parametrize("squares", [(1, 1), (2, 0), (-1, 3)])
def test_a_cut_to_squares_that_look_alike_is_noticed(squares: tuple[int, int]) -> None:
    """Moved by whole squares, every corner is where another was; markers tell them apart."""
    before: View = (0, 0, 0, [0, 0, 620])
    after: View = (0, 0, 0, [30.0 * squares[0], 30.0 * squares[1], 620])
    tracker = BoardTracker(BOARD, LENS)
    follow(tracker, [picture(before)])
    (found,) = follow(tracker, [picture(after, seed=1)])
    truth = true_pose(BOARD, after)
    middle = np.array([[BOARD.size_mm[0] / 2, 0, BOARD.size_mm[1] / 2]])
    assert np.linalg.norm(found.pose.points(middle) - truth.points(middle)) < 1.5


def test_a_cut_to_another_view_is_searched() -> None:
    tracker = BoardTracker(BOARD, LENS)
    other: View = (-25, 20, 160, [-60, -40, 560])
    follow(tracker, film()[:2])
    (found,) = follow(tracker, [picture(other)])
    assert tracker.searched == 2
    assert off(found, true_pose(BOARD, other))[0] < 0.3
    # what moved before the cut says nothing of what comes after it
    follow(tracker, [picture(other, seed=1)])
    assert tracker.searched == 2


def test_hidden_corners_drop_out_and_come_back() -> None:
    tracker = BoardTracker(BOARD, LENS)
    follow(tracker, film()[:3])
    pixels = project(BOARD.corners(), true_pose(BOARD, moving(3)), LENS)
    left, top = pixels[[0, 1, 7, 8]].min(0).astype(int) - 6
    right, bottom = pixels[[0, 1, 7, 8]].max(0).astype(int) + 6
    covered = film()[3].copy()
    covered[top:bottom, left:right] = [200, 150, 120]
    (seen,) = follow(tracker, [covered])
    inside = ((pixels > [left, top]) & (pixels < [right, bottom])).all(1)
    assert CORNERS - 14 <= seen.corners <= CORNERS - inside.sum()
    assert off(seen, true_pose(BOARD, moving(3)))[0] < 0.2
    (back,) = follow(tracker, film()[4:5])
    assert back.corners == CORNERS
    assert tracker.searched == 1


def test_another_size_is_refused() -> None:
    tracker = BoardTracker(BOARD, replace(LENS, width=960))
    with pytest.raises(InputError, match="calibrate with pictures of this size"):
        tracker.pose(film()[0])
