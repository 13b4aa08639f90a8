"""The camera's pose from a board in its picture.

A pose is the rigid transform ``camera_from_world``, in mm, from the frame of the board (see
:class:`~skylight.cameras.board.Board`) or of a probe to skylight's camera, which looks along -Z
with +Y up and +X to the right.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import UInt8

from skylight.cameras.board import Board
from skylight.cameras.detect import BoardCorners, find_corners
from skylight.cameras.intrinsics import FLIPPED, Intrinsics
from skylight.cameras.view import project
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
    opencv_from_board = RigidTransform.from_numpy(OPENCV_FROM_BOARD, np.zeros(3))
    found: list[tuple[float, RigidTransform]] = []
    for turn, shift in zip(turns[:count], shifts[:count], strict=True):
        turn, shift = cv2.solvePnPRefineLM(
            points, corners.pixels, *lens, turn.astype(np.float64), shift.astype(np.float64)
        )
        vector = torch.from_numpy(np.concatenate([turn.ravel(), shift.ravel()]))
        if vector[5] <= 0 or not vector.isfinite().all():
            continue
        pose = FLIPPED @ RigidTransform.from_vector(vector) @ opencv_from_board
        miss = project(corners.points, pose, intrinsics) - corners.pixels
        found.append((float(np.sqrt((miss**2).sum(1).mean())), pose))
    if not found:
        return None
    found.sort(key=lambda each: each[0])
    best = found[0][1]
    # seen from near, the refinement of the mirrored pose often ends in the right one
    others = [rms for rms, pose in found[1:] if (pose @ best.inverse()).angle_deg > _SAME_DEG]
    return BoardPose(
        pose=best,
        corners=len(corners),
        rms_px=found[0][0],
        mirror_rms_px=min(others, default=float("inf")),
    )
