"""What a picture shows of points that are known in the world.

Poses are ``camera_from_world``.
"""

import numpy as np
from jaxtyping import Bool, Float, UInt8, UInt16

from skylight.cameras.intrinsics import FLIP, Intrinsics
from skylight.sphere.rigid_transform import RigidTransform

Picture = UInt8[np.ndarray, "_ _ 3"] | UInt16[np.ndarray, "_ _ 3"]


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
