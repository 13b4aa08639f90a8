"""Camera intrinsics: focal lengths, principal point and lens distortion.

Two ways to say where a camera's axes and pixels are meet here:

================  ==============================  =====================
                  OpenCV (:class:`Intrinsics`)    skylight (``Camera``)
================  ==============================  =====================
looks along       +Z                              -Z
picture's top     -Y                              +Y
pixel centres     integers                        integers + 0.5
================  ==============================  =====================

so that a point goes from one to the other by (X, Y, Z) -> (X, -Y, -Z) and a place in the picture by
adding 0.5.
"""

import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from skylight.errors import InputError
from skylight.io.files import write_json
from skylight.io.json_files import (
    read_number,
    read_object,
    read_whole,
    require_keys,
)
from skylight.sphere.rigid_transform import RigidTransform

FLIP = np.diag([1.0, -1.0, -1.0])  # OpenCV's camera frame <-> skylight's
FLIPPED = RigidTransform.from_numpy(FLIP, np.zeros(3))
_KIND = "camera intrinsics"
_NEWTON_MOST = 30


@dataclass(frozen=True, kw_only=True)
class Intrinsics:
    """A pinhole with Brown's distortion, for pictures of ``width`` x ``height`` pixels, as OpenCV::

        x = X / Z, y = Y / Z, r^2 = x^2 + y^2, c = 1 + k1 r^2 + k2 r^4 + k3 r^6
        u = fx (x c + 2 p1 x y + p2 (r^2 + 2 x^2)) + cx
        v = fy (y c + p1 (r^2 + 2 y^2) + 2 p2 x y) + cy

    (Brown 1966, "Decentering distortion of lenses".) Lengths are in pixels, pixel centres at
    integers; ``rms_px`` is the error left after calibration.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    rms_px: float = 0.0

    def __post_init__(self) -> None:
        numbers = [value for value in asdict(self).values() if isinstance(value, float)]
        if not all(math.isfinite(value) for value in numbers):
            raise InputError("a camera's numbers must be finite; calibrate it again")
        if min(self.fx, self.fy) <= 0 or min(self.width, self.height) < 1 or self.rms_px < 0:
            raise InputError(
                f"focal lengths and picture size must be above 0 and rms_px not below, got "
                f"{self.fx:g}, {self.fy:g}, {self.width}, {self.height}, {self.rms_px:g}"
            )
        if abs(math.log(self.fx / self.fy)) > math.log(2):
            raise InputError(
                f"the focal lengths {self.fx:g} and {self.fy:g} differ too much for a camera"
            )

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=np.float64)

    @property
    def distortion(self) -> Float[np.ndarray, "5"]:
        """(k1, k2, p1, p2, k3), OpenCV's order."""
        return np.array([self.k1, self.k2, self.p1, self.p2, self.k3], dtype=np.float64)

    def project(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Places of points in OpenCV's camera frame (Z > 0 before the camera), px."""
        if not len(points):
            return np.zeros((0, 2))
        still = np.zeros(3)
        pixels, _ = cv2.projectPoints(
            np.ascontiguousarray(points, dtype=np.float64), still, still, self.matrix,
            self.distortion,
        )  # fmt: skip
        return pixels.reshape(-1, 2)

    def undistort_points(self, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Where the same points would be without distortion, with the same fx, fy, cx, cy; px."""
        if not len(pixels):
            return np.zeros((0, 2))
        focal, center = np.array([self.fx, self.fy]), np.array([self.cx, self.cy])
        ideal = (np.asarray(pixels, dtype=np.float64) - center) / focal
        goal, step = ideal.copy(), 1e-6
        for _ in range(_NEWTON_MOST):
            miss = self._distorted(ideal) - goal
            slopes = [
                (self._distorted(ideal + d) - self._distorted(ideal - d)) / (2 * step)
                for d in step * np.eye(2)
            ]
            change = np.linalg.solve(np.stack(slopes, -1), miss[..., None])[..., 0]
            ideal = ideal - change
            if np.abs(change).max() < 1e-12:
                break
        return ideal * focal + center

    def _distorted(self, ideal: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """(x, y) = (X, Y) / Z after the lens, still in units of the focal length."""
        x, y = ideal.T
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return np.stack(
            [
                x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x),
                y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y,
            ],
            1,
        )

    def require_size(self, width: int, height: int) -> None:
        """Refuse a picture of another size."""
        if (width, height) != (self.width, self.height):
            turned = (width, height) == (self.height, self.width)
            mend = (
                "hold the camera as when it was calibrated"
                if turned
                else "calibrate with pictures of this size"
            )
            raise InputError(
                f"the picture has {width}x{height} pixels and the camera was calibrated for "
                f"{self.width}x{self.height}: {mend}"
            )


def save_intrinsics(path: str | Path, intrinsics: Intrinsics) -> None:
    """Write the camera as JSON."""
    write_json(path, describe_intrinsics(intrinsics))


def describe_intrinsics(intrinsics: Intrinsics) -> dict[str, object]:
    """What the file holds."""
    note = "OpenCV's model: pixel centres at integers, looks along +Z, Y down"
    return {"kind": _KIND, "convention": note, **asdict(intrinsics)}


def load_intrinsics(path: str | Path) -> Intrinsics:
    """The camera that :func:`save_intrinsics` wrote.

    Raises
    ------
    InputError
        The file is missing or no such file, or its values cannot be.
    """
    content = read_object(path, _KIND)
    names = [field.name for field in fields(Intrinsics)]
    require_keys(path, content, names)
    lens = [name for name in names if name not in ("width", "height")]
    try:
        return Intrinsics(
            width=read_whole(content, "width"),
            height=read_whole(content, "height"),
            **{name: read_number(content, name) for name in lens},
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
