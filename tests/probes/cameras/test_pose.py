"""Corners found in pictures, and poses from them."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.probes.cameras._board import Board
from skylight.probes.cameras._intrinsics import FLIP, Intrinsics
from skylight.probes.cameras._live import Frame
from skylight.probes.cameras._pose import (
    BoardCorners,
    board_pose,
    camera_centre,
    corners_pose,
    find_corners,
    project,
)
from skylight.sphere._rotation import RigidTransform
from skylight.transport._cameras import Camera
from tests.probes.cameras.conftest import VIEWS
from tests.probes.cameras.scenes import LENS, board_from_tilt, picture_of_board

WEBCAM = replace(LENS, width=640, height=480, fx=525.0, fy=526.0, cx=318.0, cy=241.0)
BOARD = Board(columns=7, rows=5, square_mm=25.0, marker_mm=18.0)


def seen(tilt_deg: float, distance_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """(picture, true places of all corners)."""
    rotation, translation = board_from_tilt(BOARD, tilt_deg, 0.0, 10.0, [0.0, 60.0, distance_mm])
    image = picture_of_board(BOARD, WEBCAM, rotation, translation)
    points = BOARD.corners()[:, [0, 2, 1]] * [1, 1, -1]
    places, _ = cv2.projectPoints(
        points, cv2.Rodrigues(rotation)[0], translation, WEBCAM.matrix, WEBCAM.distortion
    )
    return image, places.reshape(-1, 2)


def read_alone(image: np.ndarray) -> int:
    """How many corners OpenCV finds by itself."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    _, numbers, _, _ = cv2.aruco.CharucoDetector(BOARD.charuco()).detectBoard(grey)
    return 0 if numbers is None else len(numbers)


@pytest.mark.parametrize(("tilt", "distance"), [(50.0, 520.0), (60.0, 520.0), (65.0, 470.0)])
def test_small_markers_are_read_and_their_corners_are_where_they_are(
    tilt: float, distance: float
) -> None:
    image, places = seen(tilt, distance)
    found = find_corners(image, BOARD)
    assert found is not None
    assert len(found) > read_alone(image)
    off = np.linalg.norm(found.pixels - places[found.numbers], axis=1)
    assert np.median(off) < 0.35
    assert off.max() < 1.5


# OpenCV's board from ours, as the Board's docstring states it: (X, Y, Z) -> (X, Z, -Y)
FLAT = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def true_pose(board: Board, view: tuple) -> RigidTransform:
    rotation, translation = board_from_tilt(board, *view)
    return RigidTransform.from_numpy(FLIP @ rotation @ FLAT, FLIP @ translation)


@pytest.mark.parametrize("number", range(1, len(VIEWS)))
def test_pose_from_a_picture(board: Board, frames: list[Frame], number: int) -> None:
    found = board_pose(frames[number].image, board, LENS)
    assert found is not None
    truth = true_pose(board, VIEWS[number])
    assert (found.pose @ truth.inverse()).angle_deg < 0.3
    apart = camera_centre(found.pose) - camera_centre(truth)
    assert np.linalg.norm(apart) < 3.0  # 0.3 degrees at 50 cm: 2.6
    middle = np.array([[board.size_mm[0] / 2, 0, board.size_mm[1] / 2]])
    assert np.linalg.norm(found.pose.points(middle) - truth.points(middle)) < 1.0
    assert found.rms_px < 0.3
    assert found.corners == 35
    assert not found.is_ambiguous


def test_exact_corners_give_the_exact_pose(board: Board) -> None:
    truth = true_pose(board, VIEWS[5])
    points = board.corners()
    pixels = project(points, truth, LENS)
    numbers = np.arange(len(points))
    found = corners_pose(BoardCorners(numbers=numbers, pixels=pixels, points=points), LENS)
    assert found is not None
    np.testing.assert_allclose(found.pose.rotation, truth.rotation, atol=1e-6)
    np.testing.assert_allclose(found.pose.translation, truth.translation, atol=1e-3)


def test_a_camera_above_a_table_has_positive_height(board: Board, frames: list[Frame]) -> None:
    found = board_pose(frames[0].image, board, LENS)
    assert found is not None
    assert camera_centre(found.pose)[1] == pytest.approx(500, abs=3)


def test_far_away_the_tilt_is_called_ambiguous(board: Board) -> None:
    far = true_pose(board, (15, 0, 0, [0, 0, 9000]))
    points = board.corners()
    generator = np.random.default_rng(3)
    pixels = project(points, far, LENS) + 0.3 * generator.standard_normal((len(points), 2))
    numbers = np.arange(len(points))
    found = corners_pose(BoardCorners(numbers=numbers, pixels=pixels, points=points), LENS)
    assert found is not None
    assert found.is_ambiguous


def test_without_the_board_there_is_none(board: Board, blank: np.ndarray) -> None:
    assert board_pose(blank, board, LENS) is None


def test_another_size_is_refused(board: Board, blank: np.ndarray) -> None:
    with pytest.raises(InputError, match="calibrate with pictures of this size"):
        board_pose(blank[:100, :100].copy(), board, LENS)


def test_the_renderers_camera_sees_points_where_a_plain_lens_does() -> None:
    pose = true_pose(Board(), VIEWS[6])
    points = np.array([[0.0, 10, 20], [50, 30, -10]])
    plain = Intrinsics(width=640, height=480, fx=500.0, fy=500.0, cx=300.0, cy=250.0)
    camera = Camera(focal_px=500.0, width=640, height=480, center_px=(300.5, 250.5))
    seen = camera.project(pose.points(torch.from_numpy(points))).numpy()
    np.testing.assert_allclose(seen - 0.5, project(points, pose, plain), atol=1e-9)
