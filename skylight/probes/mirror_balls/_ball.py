"""A ball in a picture: its cone of tangent rays, from a circle or from its detected outline."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from skylight.errors import InputError
from skylight.sphere._envmap import luminance
from skylight.transport._cameras import Camera

# The limit of a long lens: the rays of a picture differ by so little that all of them are parallel.
PARALLEL_FOV_DEG = 0.1
RADIUS_MIN_PX = 16.0
_HALF_ANGLE_MAX = math.radians(60.0)
_SEARCH_PX = 480  # longer side of the picture in which circles are searched for
_STRICTNESS = (0.9, 0.75, 0.6, 0.4)  # OpenCV's perfectness of circles, from the best downwards
_CANDIDATES = 10
_RADII = (0.08, 0.52)  # of the shorter side
_PROFILES = 360  # across the outline
_WIDE, _NARROW = 0.12, (0.02, 0.01)  # of the radius, in which edges are searched for
_PEAKS, _TRIALS = 3, 600  # of a profile; of triples of edges
_STEEP_MIN = 24  # profiles with an edge, below which there is no ball
_SLOPE_MIN, _STEEPER = 0.01, 1.5  # least slope per px, absolute and against the median
_ON_OUTLINE_PX = 1.5
_SUPPORT_MIN = 0.35
_INWARD = 3.0
_NEARLY = 0.8  # of the best support: as good, so that the larger ball counts


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
    """Focal length in px of a picture so high whose vertical field of view is ``fov_deg``."""
    if not PARALLEL_FOV_DEG <= fov_deg <= 170:
        raise InputError(
            f"a vertical field of view is {PARALLEL_FOV_DEG:g} to 170 degrees, got {fov_deg:g}"
        )
    return 0.5 * height / math.tan(math.radians(fov_deg) / 2)


def ball_of_circle(camera: Camera, x: float, y: float, radius: float) -> Ball:
    """The ball whose outline is nearest to a circle, all in px."""
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


@dataclass(frozen=True, kw_only=True)
class Outline:
    """A ball, and the share of its outline at which an edge was seen within 1.5 px.

    ``support`` is None where the outline was given.
    """

    ball: Ball
    support: float | None


def find_ball(radiance: Float[Tensor, "h w 3"], camera: Camera) -> Outline:
    """The largest well-supported ball in a picture of linear light.

    Circles by OpenCV's Hough transform in the cube root of light are first guesses. In profiles
    across each, the steepest places vote (RANSAC; Fischler & Bolles 1981) for a ball, whose cone of
    rays is then fitted to them by robust least squares
    (:func:`skylight.probes.mirror_balls._ball.fit_ball`).
    """
    grey = evened(radiance)
    found: list[tuple[float, Ball]] = []
    for x, y, radius in _circles(grey):
        try:
            found.append(_refined(grey, ball_of_circle(camera, x, y, radius)))
        except InputError:  # reaches out of the picture, or its edges are no ball's
            continue
    best = max((support for support, _ in found), default=0.0)
    if best < _SUPPORT_MIN:
        raise InputError(
            "no ball's outline was found in the picture; give its middle and radius in pixels "
            "with --ball X Y RADIUS"
        )
    good = [each for each in found if each[0] >= _NEARLY * best]
    support, ball = max(good, key=lambda each: each[1].half_angle_rad)
    return Outline(ball=ball, support=support)


def evened(radiance: Float[Tensor, "h w 3"]) -> Float[np.ndarray, "h w"]:
    """Cube root of luminance over its mean: edges count about alike in dark and bright."""
    light = luminance(radiance).numpy()
    return np.cbrt(light / max(float(light.mean()), 1e-30)).astype(np.float32)


def _circles(grey: Float[np.ndarray, "h w"]) -> list[tuple[float, float, float]]:
    """(x, y, radius) in px of the picture, the best first."""
    scale = min(1.0, _SEARCH_PX / max(grey.shape))
    small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    # OpenCV may round the size; the picture's own ratio is what counts
    scale = small.shape[1] / grey.shape[1]
    codes = cv2.GaussianBlur(_codes(small), (5, 5), 1.2)
    low, high = (round(share * min(small.shape)) for share in _RADII)
    for strictness in _STRICTNESS:
        circles = cv2.HoughCircles(
            codes,
            cv2.HOUGH_GRADIENT_ALT,
            dp=1.5,
            minDist=4,
            param1=120,
            param2=strictness,
            minRadius=max(low, math.ceil(RADIUS_MIN_PX * scale)),
            maxRadius=high,
        )
        if circles is not None:
            return [
                ((x + 0.5) / scale, (y + 0.5) / scale, radius / scale)
                for x, y, radius in circles.reshape(-1, 3)[:_CANDIDATES].astype(float)
            ]
    return []


def _codes(grey: Float[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    low, high = np.quantile(grey, (0.01, 0.99))
    return np.rint(255 * np.clip((grey - low) / max(high - low, 1e-6), 0, 1)).astype(np.uint8)


def _refined(grey: Float[np.ndarray, "h w"], ball: Ball) -> tuple[float, Ball]:
    """(support, ball) of the outline near a first guess."""
    smooth = cv2.GaussianBlur(grey, (0, 0), 0.8)
    points, steep = _edges(smooth, ball, _WIDE, _PEAKS)
    if steep.any(1).sum() < _STEEP_MIN:
        return 0.0, ball
    ball = _most_agreed(ball, points, steep)
    for window in _NARROW:
        points, steep = _edges(smooth, ball, window, 1)
        if steep.sum() < _STEEP_MIN:
            return 0.0, ball
        points, steep = points[:, 0], steep[:, 0]
        for _ in range(5):
            distance = distances_px(ball, points)
            spread = max(0.5, 1.5 * float(np.median(np.abs(distance[steep]))))
            # Cauchy's weights, narrower inside of the outline: edges of what the ball mirrors
            apart = np.where(distance < 0, _INWARD, 1.0) * distance / spread
            ball = fit_ball(ball.camera, points, steep / (1 + apart**2))
    ball_of_circle(ball.camera, *ball.circle)  # refuses what grew out of the picture
    near = np.abs(distances_px(ball, points)) < _ON_OUTLINE_PX
    return float((near & steep).mean()), ball


def _most_agreed(
    ball: Ball, points: Float[np.ndarray, "n k 2"], steep: Bool[np.ndarray, "n k"]
) -> Ball:
    """The ball through three edges that passes within 1.5 px of an edge in most profiles.

    What the ball mirrors has edges within the window too, often steeper than the outline's; but
    they lie on no common circle.
    """
    generator = np.random.default_rng(0)
    profiles = np.flatnonzero(steep.any(1))
    trials = [(0, ball)]
    for _ in range(_TRIALS):
        chosen = generator.choice(profiles, 3, replace=False)
        peaks = [generator.choice(np.flatnonzero(steep[row])) for row in chosen]
        try:
            trial = fit_ball(ball.camera, points[chosen, peaks])
        except InputError:
            continue
        distance = distances_px(trial, points.reshape(-1, 2)).reshape(steep.shape)
        agreed = int(((np.abs(distance) < _ON_OUTLINE_PX) & steep).any(1).sum())
        trials.append((agreed, trial))
    enough = _NEARLY * max(agreed for agreed, _ in trials)
    # edges just inside of the outline look like it; hardly any do outside
    return max(
        (trial for agreed, trial in trials if agreed >= enough),
        key=lambda trial: trial.half_angle_rad,
    )


def _edges(
    smooth: Float[np.ndarray, "h w"], ball: Ball, window: float, most: int
) -> tuple[Float[np.ndarray, "n k 2"], Bool[np.ndarray, "n k"]]:
    """The ``most`` steepest places (x, y), in px, of each profile across the outline.

    Profiles reach ``window`` radii to either side. Second: whether each is a place of its own, and
    clearly steeper than most.
    """
    outline = ball.outline(_PROFILES)
    outward = outline - outline.mean(0)
    radius = np.linalg.norm(outward, axis=1, keepdims=True)
    outward = outward / radius
    half = max(4.0, window * float(radius.mean()))
    steps = np.arange(-half - 1, half + 1.01, 0.5)
    at = (outline[:, None] + steps[:, None] * outward[:, None] - 0.5).astype(np.float32)
    profile = cv2.remap(
        smooth, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    slope = np.abs(profile[:, 2:] - profile[:, :-2])
    inner = slope[:, 1:-1]
    is_peak = (inner >= slope[:, :-2]) & (inner > slope[:, 2:])
    order = np.argsort(-inner * is_peak, axis=1)[:, :most]
    left, top, right = (np.take_along_axis(slope, order + shift, 1) for shift in (0, 1, 2))
    bend = left - 2 * top + right
    between = np.where(bend < 0, 0.5 * (left - right) / np.where(bend < 0, bend, 1), 0)
    step = steps[2:-2][order] + 0.5 * np.clip(between, -0.5, 0.5)
    points = outline[:, None] + step[..., None] * outward[:, None]
    floor = max(_SLOPE_MIN, _STEEPER * float(np.median(slope)))
    return points, np.take_along_axis(is_peak, order, 1) & (top > floor)
