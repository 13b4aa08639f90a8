"""Corners of boards whose markers are only a dozen pixels wide."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from skylight.probes.cameras._board import Board
from skylight.probes.cameras._pose import find_corners
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
