"""A ball in a picture: its cone of tangent rays, from a circle or fitted to its outline."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from skylight.errors import InputError
from skylight.transport.camera import Camera

# The limit of a long lens: the rays of a picture differ by so little that all of them are parallel.
PARALLEL_FOV_DEG = 0.1
RADIUS_MIN_PX = 16.0
_HALF_ANGLE_MAX = math.radians(60.0)


@dataclass(frozen=True, kw_only=True)
class Ball:
    """Directions to the ball's middle (3,), float64 and unit, and its angular radius."""

    camera: Camera
    axis: Float[np.ndarray, "3"]
    half_angle_rad: float

    @property
    def distance(self) -> float:
        """From the camera to the ball's middle, in radii of the ball: 1 / sin(half angle)."""
        return 1 / math.sin(self.half_angle_rad)

    def outline(self, count: int = 720) -> Float[np.ndarray, "n 2"]:
        """Points (x, y) of the outline in px: an ellipse, where the ball is off the picture's axis.

        Equally spaced round the axis, starting anywhere.
        """
        across = np.cross(self.axis, [0.0, 1.0, 0.0])
        across /= np.linalg.norm(across)
        upward = np.cross(across, self.axis)
        turn = np.linspace(0, 2 * math.pi, count, endpoint=False)[:, None]
        sideways = np.cos(turn) * across + np.sin(turn) * upward
        rays = math.cos(self.half_angle_rad) * self.axis + math.sin(self.half_angle_rad) * sideways
        return self.camera.project(torch.from_numpy(rays)).numpy()

    @property
    def circle(self) -> tuple[float, float, float]:
        """Middle (x, y) and mean radius of the outline in px."""
        points = self.outline()
        middle = points.mean(0)
        radius = np.linalg.norm(points - middle, axis=1).mean()
        return float(middle[0]), float(middle[1]), float(radius)


def picture_camera(height: int, width: int, focal_px: float | None) -> Camera:
    """The pinhole camera of an uncropped picture; rays that are parallel for ``focal_px`` None."""
    if focal_px is None:
        focal_px = focal_from_fov(height, PARALLEL_FOV_DEG)
    return Camera(focal_px=focal_px, width=width, height=height, center_px=(width / 2, height / 2))


def focal_from_fov(height: int, fov_deg: float) -> float:
    """Focal length in px of a picture so high whose vertical field of view is ``fov_deg``.

    Raises
    ------
    InputError
        A field outside 0.1 to 170 degrees.
    """
    if not PARALLEL_FOV_DEG <= fov_deg <= 170:
        raise InputError(
            f"a vertical field of view is {PARALLEL_FOV_DEG:g} to 170 degrees, got {fov_deg:g}"
        )
    return 0.5 * height / math.tan(math.radians(fov_deg) / 2)


def ball_of_circle(camera: Camera, x: float, y: float, radius: float) -> Ball:
    """The ball whose outline is nearest to a circle, all in px.

    Raises
    ------
    InputError
        A circle that is not wholly in the picture, or too small.
    """
    if not all(math.isfinite(value) for value in (x, y, radius)) or radius < RADIUS_MIN_PX:
        raise InputError(
            f"a ball must have a radius of {RADIUS_MIN_PX:g} px or more, got {radius:g}"
        )
    beyond = max(radius - x, radius - y, x + radius - camera.width, y + radius - camera.height)
    if beyond > 1:
        raise InputError(
            f"the ball at {x:g},{y:g} with radius {radius:g} reaches {beyond:.0f} px out of the "
            f"picture of {camera.width}x{camera.height}: its outline must be seen all round"
        )
    turn = np.linspace(0, 2 * math.pi, 360, endpoint=False)
    return fit_ball(camera, np.stack([x + radius * np.cos(turn), y + radius * np.sin(turn)], -1))


def fit_ball(
    camera: Camera,
    points: Float[np.ndarray, "n 2"],
    weights: Float[np.ndarray, " n"] | None = None,
) -> Ball:
    """The ball whose outline passes through ``points`` (px) in the sense of least squares.

    A ray p = (x, y, -1) touches the ball where ``p.d = |p| cos(a)``. With v = d / cos(a) that is
    linear, ``p.v = |p|``; v = (v1, v2, -1 - e) keeps it exact for parallel rays::

        v1 x + v2 y + e = |p| - 1,    tan^2(a) = v1^2 + v2^2 + 2 e + e^2

    Raises
    ------
    InputError
        Points on no outline of a ball.
    """
    x, y, excess, scale = _scaled(camera, points)
    rows = np.stack([x / scale, y / scale, np.ones_like(x)], -1)
    root = np.sqrt(np.ones(len(x)) if weights is None else weights)
    solution, *_ = np.linalg.lstsq(rows * root[:, None], excess / scale**2 * root, rcond=None)
    v1, v2, e = solution * np.array([scale, scale, scale**2])
    squared = v1**2 + v2**2 + 2 * e + e**2
    if not 0 < squared < math.tan(_HALF_ANGLE_MAX) ** 2:
        raise InputError("no ball's outline passes through these points")
    axis = np.array([v1, v2, -1 - e])
    return Ball(
        camera=camera,
        axis=axis / np.linalg.norm(axis),
        half_angle_rad=math.atan(math.sqrt(squared)),
    )


def distances_px(ball: Ball, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """How far outside of the outline each point (px) is, to first order."""
    x, y, excess, _ = _scaled(ball.camera, points)
    v = ball.axis / math.cos(ball.half_angle_rad)
    # -v3 - 1 without cancellation for parallel rays
    squared = math.tan(ball.half_angle_rad) ** 2 - v[0] ** 2 - v[1] ** 2
    e = squared / (1 + math.sqrt(1 + squared))
    length = 1 + excess
    slope = np.hypot(x / length - v[0], y / length - v[1])
    return (excess - v[0] * x - v[1] * y - e) / slope * ball.camera.focal_px


def _scaled(
    camera: Camera, points: Float[np.ndarray, "n 2"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """x, y (up) of rays (x, y, -1), ``|ray| - 1``, and the largest of x and y."""
    x = (points[:, 0] - camera.center_px[0]) / camera.focal_px
    y = (camera.center_px[1] - points[:, 1]) / camera.focal_px
    squared = x**2 + y**2
    return x, y, squared / (1 + np.sqrt(1 + squared)), float(np.sqrt(squared.max()))
