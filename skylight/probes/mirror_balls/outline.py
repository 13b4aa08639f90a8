"""Detection of a mirror ball in a picture by its outline."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.mirror_balls.ball import (
    RADIUS_MIN_PX,
    Ball,
    ball_of_circle,
    distances_px,
    fit_ball,
)
from skylight.sphere.envmap import luminance
from skylight.transport.camera import Camera

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
    (:func:`skylight.probes.mirror_balls.ball.fit_ball`).

    Raises
    ------
    InputError
        No ball is found.
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
