"""The camera's pose from a board in its picture.

A pose is the rigid transform ``camera_from_world``, in mm, from the frame of the board (see
:class:`~skylight.cameras.board.Board`) or of a probe to skylight's camera, which looks along -Z
with +Y up and +X to the right.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from skylight.cameras.board import Board
from skylight.cameras.detect import BoardCorners, find_corners
from skylight.cameras.intrinsics import FLIP, Intrinsics
from skylight.sphere.rigid_transform import RigidTransform

_SAME_DEG = 0.5
# the board's frame in OpenCV's for boards: x right, y down the paper, z into it
OPENCV_FROM_BOARD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


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
