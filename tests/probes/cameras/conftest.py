"""A board, and pictures of it taken once for all tests."""

import numpy as np
import pytest

from skylight.probes.cameras._board import Board
from skylight.probes.cameras._live import Frame
from skylight.probes.cameras._pose import BoardCorners, find_corners
from tests.probes.cameras.scenes import LENS, board_from_tilt, picture_of_board

VIEWS = [  # tilts about x and y, turn, degrees; the board's middle in OpenCV's camera frame, mm
    (0, 0, 0, [0, 0, 500]),
    (30, 0, 5, [-80, 40, 480]),
    (-30, 5, -10, [80, -40, 480]),
    (5, 32, 90, [60, 40, 520]),
    (0, -32, 80, [-70, -50, 520]),
    (25, 22, 40, [100, 60, 560]),
    (-22, -25, -30, [-110, 70, 560]),
    (-20, 25, 95, [-90, -60, 450]),
]


@pytest.fixture(scope="session")
def board() -> Board:
    return Board(columns=8, rows=6, square_mm=30.0, marker_mm=21.0)


@pytest.fixture(scope="session")
def frames(board: Board) -> list[Frame]:
    return [
        Frame(
            name=f"view {i}",
            image=picture_of_board(board, LENS, *board_from_tilt(board, *view), seed=i),
        )
        for i, view in enumerate(VIEWS)
    ]


@pytest.fixture(scope="session")
def corners(board: Board, frames: list[Frame]) -> list[tuple[str, BoardCorners]]:
    found = [(frame.name, find_corners(frame.image, board)) for frame in frames]
    return [(name, each) for name, each in found if each is not None]


@pytest.fixture(scope="session")
def blank() -> np.ndarray:
    return np.full((LENS.height, LENS.width, 3), 120, dtype=np.uint8)
