"""The camera's pose from a board in its picture, and where a pose shows points of the world.

A pose is the rigid transform ``camera_from_world``, in mm, from the frame of the board (see
:class:`~skylight.probes.cameras._board.Board`) or of a probe to skylight's camera, which looks
along -Z with +Y up and +X to the right.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8, UInt16

from skylight.errors import InputError
from skylight.probes.cameras._board import Board
from skylight.probes.cameras._intrinsics import FLIP, Intrinsics
from skylight.sphere._rotation import RigidTransform

CORNERS_MIN = 6  # a homography needs 4; two more show whether it fits
_ENLARGE_BELOW_PX = 1_000_000  # pictures in which markers may be too small to be read as they are
_SAME_DEG = 0.5
# the board's frame in OpenCV's for boards: x right, y down the paper, z into it
OPENCV_FROM_BOARD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
Picture = UInt8[np.ndarray, "_ _ 3"] | UInt16[np.ndarray, "_ _ 3"]


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


@dataclass(frozen=True, kw_only=True)
class BoardPose:
    """A pose, the number of corners it was estimated from, and their RMS reprojection error.

    The pose of a plane is ambiguous: tilted the other way, it fits nearly as well.
    ``mirror_rms_px`` is the error of that second pose, infinite where there is none. Where it is
    close to ``rms_px``, do not trust the tilt.
    """

    pose: RigidTransform
    corners: int
    rms_px: float
    mirror_rms_px: float

    @property
    def is_ambiguous(self) -> bool:
        """Whether the board tilted the other way fits as well, within half as much again."""
        return self.mirror_rms_px < 1.5 * self.rms_px


def board_pose(
    image: UInt8[np.ndarray, "h w 3"], board: Board, intrinsics: Intrinsics
) -> BoardPose | None:
    """The pose of the board's frame in a picture as the camera took it; None without the board.

    Raises
    ------
    InputError
        A picture of another size than that which the camera was calibrated for.
    """
    intrinsics.require_size(image.shape[1], image.shape[0])
    corners = find_corners(image, board)
    return None if corners is None else corners_pose(corners, intrinsics)


def corners_pose(corners: BoardCorners, intrinsics: Intrinsics) -> BoardPose | None:
    """The pose from six or more corners, not all on a line; None where there is none.

    Both poses of a plane (Collins & Bartoli 2014, "Infinitesimal plane-based pose estimation"),
    each refined to the least squares of the reprojection error; the better one counts.
    """
    points = corners.points @ OPENCV_FROM_BOARD.T
    # IPPE wants the points' plane exactly at z = 0
    points = np.ascontiguousarray(np.stack([points[:, 0], points[:, 1], 0 * points[:, 0]], 1))
    lens = intrinsics.matrix, intrinsics.distortion
    count, turns, shifts, _ = cv2.solvePnPGeneric(
        points, corners.pixels, *lens, flags=cv2.SOLVEPNP_IPPE
    )
    found: list[tuple[float, np.ndarray, np.ndarray]] = []
    for turn, shift in zip(turns[:count], shifts[:count], strict=True):
        turn, shift = cv2.solvePnPRefineLM(
            points, corners.pixels, *lens, turn.astype(np.float64), shift.astype(np.float64)
        )
        if not (np.isfinite(turn).all() and np.isfinite(shift).all() and shift[2] > 0):
            continue
        seen, _ = cv2.projectPoints(points, turn, shift, *lens)
        miss = seen.reshape(-1, 2) - corners.pixels
        found.append((float(np.sqrt((miss**2).sum(1).mean())), cv2.Rodrigues(turn)[0], shift))
    if not found:
        return None
    found.sort(key=lambda each: each[0])
    rms, rotation, shift = found[0]
    # seen from near, the refinement of the mirrored pose often ends in the right one
    others = [miss for miss, other, _ in found[1:] if _angle_deg(rotation, other) > _SAME_DEG]
    return BoardPose(
        pose=RigidTransform.from_numpy(FLIP @ rotation @ OPENCV_FROM_BOARD, FLIP @ shift.ravel()),
        corners=len(corners),
        rms_px=rms,
        mirror_rms_px=min(others, default=float("inf")),
    )


def _angle_deg(one: Float[np.ndarray, "3 3"], other: Float[np.ndarray, "3 3"]) -> float:
    """Of the rotation between two rotations."""
    return float(np.degrees(np.arccos(np.clip(((one * other).sum() - 1) / 2, -1, 1))))


def camera_centre(pose: RigidTransform) -> Float[np.ndarray, "3"]:
    """The centre of projection in the world, -R^T t."""
    return pose.inverse().translation.numpy()


def project(
    points: Float[np.ndarray, "n 3"], pose: RigidTransform, intrinsics: Intrinsics
) -> Float[np.ndarray, "n 2"]:
    """World points in the camera's own, distorted picture, as OpenCV counts; px."""
    return intrinsics.project(pose.points(points) @ FLIP)


def in_frame(
    points: Float[np.ndarray, "n k 3"], pose: RigidTransform, intrinsics: Intrinsics
) -> tuple[Float[np.ndarray, "n k 2"], Bool[np.ndarray, " n"]]:
    """(places in the picture, px; which groups of k points are all in it)."""
    flat = points.reshape(-1, 3)
    in_camera = (pose.points(flat) @ FLIP).reshape(points.shape)
    pixels = project(flat, pose, intrinsics).reshape(*points.shape[:2], 2)
    size = np.array([intrinsics.width, intrinsics.height])
    inside = ((pixels >= 0) & (pixels <= size - 1)).all(2) & (in_camera[..., 2] > 0)
    # distortion folds what is far outside back into the frame; a pinhole does not
    ideal = in_camera[..., :2] / in_camera[..., 2:] * (intrinsics.fx, intrinsics.fy)
    inside &= (np.abs(ideal) < size).all(2)
    return pixels, np.asarray(inside.all(1))


def part_around(
    image: Picture, pixels: Float[np.ndarray, "*n 2"]
) -> tuple[Picture, tuple[int, int]]:
    """(the part of a picture that is enough to interpolate there, its corner's column and row)."""
    flat = pixels.reshape(-1, 2)
    left, top = np.floor(flat.min(0)).astype(int).tolist()
    right, bottom = np.ceil(flat.max(0)).astype(int).tolist()
    return np.ascontiguousarray(image[top : bottom + 2, left : right + 2]), (left, top)
