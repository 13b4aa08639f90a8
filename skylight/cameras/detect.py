"""Detection of the corners of a board."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from skylight.cameras.board import Board
from skylight.errors import InputError

CORNERS_MIN = 6  # a homography needs 4; two more show whether it fits
_ENLARGE_BELOW_PX = 1_000_000  # pictures in which markers may be too small to be read as they are


@dataclass(frozen=True, kw_only=True)
class BoardCorners:
    """Corners that were found: their numbers and where they are.

    ``pixels`` as OpenCV counts (pixel centres at integers), ``points`` in the board's frame, mm.
    """

    numbers: Int[np.ndarray, " n"]
    pixels: Float[np.ndarray, "n 2"]
    points: Float[np.ndarray, "n 3"]

    def __len__(self) -> int:
        return len(self.numbers)


def find_corners(image: UInt8[np.ndarray, "h w 3"], board: Board) -> BoardCorners | None:
    """The corners of the board that show in an RGB picture.

    None where fewer than 6 are seen or all of those lie on one line.
    """
    return grey_corners(as_grey(image), board)


def as_grey(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
    """Luma of an RGB picture."""
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise InputError(
            f"a picture must be uint8 of shape (height, width, 3), got {image.dtype} of "
            f"{image.shape}"
        )
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def grey_corners(grey: UInt8[np.ndarray, "h w"], board: Board) -> BoardCorners | None:
    """:func:`find_corners` in luma."""
    parameters = cv2.aruco.CharucoParameters()
    # markers of a dozen pixels are often misread; where the others say they must be, they count
    parameters.tryRefineMarkers = True
    detector = cv2.aruco.CharucoDetector(board.charuco(), parameters)
    found, numbers, _, _ = detector.detectBoard(grey)
    if _too_few(numbers) and grey.size < _ENLARGE_BELOW_PX:
        double = cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
        found, numbers, _, _ = detector.detectBoard(double)
        # pixel centres at integers: the corner of the picture is at -1/2 in both
        found = None if found is None else (np.asarray(found) + 0.5) / 2 - 0.5
    if found is None or _too_few(numbers):
        return None
    numbers = np.asarray(numbers).ravel().astype(np.int64)
    points = board.corners()[numbers]
    if not spread_out(points, board):
        return None
    pixels = np.asarray(found, dtype=np.float64).reshape(-1, 2)
    return BoardCorners(numbers=numbers, pixels=pixels, points=points)


def spread_out(points: Float[np.ndarray, "n 3"], board: Board) -> bool:
    """Whether corners are enough for a pose: six or more that do not lie on one line."""
    if len(points) < CORNERS_MIN:
        return False
    spread = np.linalg.svd(points[:, [0, 2]] - points[:, [0, 2]].mean(0), compute_uv=False)
    return bool(spread[1] >= 0.5 * board.square_mm)


def _too_few(numbers: np.ndarray | None) -> bool:
    return numbers is None or len(numbers) < CORNERS_MIN
