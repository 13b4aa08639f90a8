"""Where the camera stood: from a board in the picture."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8

from skylight.errors import InputError
from skylight.probes.capture.board import Board
from skylight.probes.capture.detect import BoardCorners, find_corners
from skylight.probes.capture.intrinsics import FLIP, Intrinsics
from skylight.transport.camera import Camera
from skylight.transport.object_camera import PlacedCamera

_RIGID = 1e-6
_SAME_DEG = 0.5
# the board's frame in OpenCV's for boards: x right, y down the paper, z into it
OPENCV_FROM_BOARD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True, kw_only=True)
class Pose:
    """``x_camera = rotation @ x_world + translation``, float64, in mm.

    The world is that of the board (see :class:`~skylight.probes.capture.board.Board`) or of a
    probe; the camera's frame is skylight's: it looks along -Z, +Y is up, +X to the right.
    """

    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, "3"]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.rotation).all() and np.isfinite(self.translation).all()):
            raise InputError("a pose must be finite")
        off = np.abs(self.rotation @ self.rotation.T - np.eye(3)).max()
        if off > _RIGID or np.linalg.det(self.rotation) < 0:
            raise InputError("a pose's rotation must be orthonormal and no mirror")

    @property
    def position(self) -> Float[np.ndarray, "3"]:
        """Where the camera stands in the world, -R^T t, mm."""
        return -self.rotation.T @ self.translation

    def to_camera(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """World points in the camera's frame."""
        return points @ self.rotation.T + self.translation

    def project(
        self, points: Float[np.ndarray, "n 3"], intrinsics: Intrinsics
    ) -> Float[np.ndarray, "n 2"]:
        """Places of world points in the camera's own, distorted picture, as OpenCV counts; px."""
        return intrinsics.project(self.to_camera(points) @ FLIP)

    def of_world_at(
        self, rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]
    ) -> "Pose":
        """The pose for another world, whose points are ``rotation @ x + translation`` in this."""
        return Pose(
            rotation=self.rotation @ rotation,
            translation=self.rotation @ translation + self.translation,
        )

    def placed(self, camera: Camera) -> PlacedCamera:
        """That camera standing here, for the renderer: world from camera, in mm."""
        return PlacedCamera(
            camera=camera,
            rotation=torch.from_numpy(self.rotation.T.copy()),
            position=torch.from_numpy(self.position.copy()),
        )


@dataclass(frozen=True, kw_only=True)
class BoardPose:
    """A pose, how many corners it rests on and by how much they miss, root mean square.

    A flat board explains a picture nearly as well when tilted the other way; ``mirror_rms_px`` is
    the error of that pose, infinite where there is none. Where it is close to ``rms_px``, do not
    trust the tilt.
    """

    pose: Pose
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
    found: list[tuple[float, Pose]] = []
    for turn, shift in zip(turns[:count], shifts[:count], strict=True):
        turn, shift = cv2.solvePnPRefineLM(
            points, corners.pixels, *lens, turn.astype(np.float64), shift.astype(np.float64)
        )
        rotation = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64)
        if shift.ravel()[2] <= 0 or not np.isfinite(rotation).all():
            continue
        pose = Pose(
            rotation=FLIP @ rotation @ OPENCV_FROM_BOARD, translation=FLIP @ np.ravel(shift)
        )
        miss = pose.project(corners.points, intrinsics) - corners.pixels
        found.append((float(np.sqrt((miss**2).sum(1).mean())), pose))
    if not found:
        return None
    found.sort(key=lambda each: each[0])
    best = found[0][1]
    # seen from near, the refinement of the mirrored pose often ends in the right one
    others = [rms for rms, pose in found[1:] if _angle_deg(pose, best) > _SAME_DEG]
    return BoardPose(
        pose=best,
        corners=len(corners),
        rms_px=found[0][0],
        mirror_rms_px=min(others, default=float("inf")),
    )


def _angle_deg(a: Pose, b: Pose) -> float:
    """How far one is turned against the other."""
    cosine = (np.trace(a.rotation @ b.rotation.T) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
