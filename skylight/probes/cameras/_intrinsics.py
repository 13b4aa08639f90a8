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

import numpy as np
from jaxtyping import Float

from skylight.errors import InputError
from skylight.io._bounded import read_number, read_object, read_whole, require_keys, write_json
from skylight.sphere._rotation import RigidTransform

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
        x, y, z = np.asarray(points, dtype=np.float64).T
        depth = np.where(z == 0, 1.0, z)
        u, v = self._bent(x / depth, y / depth)
        return np.stack([u * self.fx + self.cx, v * self.fy + self.cy], 1)

    def undistort_points(self, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Where the same points would be without distortion, with the same fx, fy, cx, cy; px."""
        if not len(pixels):
            return np.zeros((0, 2))
        u, v = np.asarray(pixels, dtype=np.float64).T
        goal_x, goal_y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        x, y = goal_x, goal_y
        for _ in range(_NEWTON_MOST):
            bent_x, bent_y = self._bent(x, y)
            off_x, off_y = bent_x - goal_x, bent_y - goal_y
            xx, xy, yy = self._slopes(x, y)
            scale = xx * yy - xy * xy
            step_x, step_y = (yy * off_x - xy * off_y) / scale, (xx * off_y - xy * off_x) / scale
            x, y = x - step_x, y - step_y
            if max(np.abs(step_x).max(), np.abs(step_y).max()) < 1e-12:
                break
        return np.stack([x * self.fx + self.cx, y * self.fy + self.cy], 1)

    def _bent(
        self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """(X, Y) / Z after the lens, in units of the focal length."""
        xx, yy, xy = x * x, y * y, x * y
        r2 = xx + yy
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return (
            x * radial + 2 * self.p1 * xy + self.p2 * (r2 + 2 * xx),
            y * radial + self.p1 * (r2 + 2 * yy) + 2 * self.p2 * xy,
        )

    def _slopes(
        self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Derivatives of :meth:`_bent`: of x by x, of x by y (as of y by x), of y by y."""
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        slope = 2 * (self.k1 + r2 * (2 * self.k2 + 3 * self.k3 * r2))
        p1, p2 = self.p1, self.p2
        return (
            radial + slope * x * x + 2 * p1 * y + 6 * p2 * x,
            slope * x * y + 2 * p1 * x + 2 * p2 * y,
            radial + slope * y * y + 6 * p1 * y + 2 * p2 * x,
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
