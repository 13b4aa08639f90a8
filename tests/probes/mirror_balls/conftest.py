"""Made light, and a mirror ball photographed in it by the float64 oracle."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
import torch

from skylight.probes.mirror_balls._ball import Ball, focal_from_fov, picture_camera
from skylight.probes.mirror_balls._merged import BallView
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from tests.oracles.mirror_ball import photograph, ray

SIZE = (240, 300)
FOV_DEG = 36.0
FOCAL_PX = focal_from_fov(SIZE[0], FOV_DEG)
MIDDLE = (160.0, 112.0)  # off the picture's middle, so that its outline is no circle
DISTANCE = 6.0
Light = Callable[[np.ndarray], np.ndarray]


def made_light(w: np.ndarray) -> np.ndarray:
    """A sky over ground with stripes and a broad lamp, different in every direction."""
    azimuth = np.arctan2(w[:, 0], -w[:, 2])
    sky = np.where(w[:, 1:2] > 0, 1.0, 0.35) * (0.6 + 0.3 * w[:, 1:2] + np.array([0, 0.05, 0.2]))
    sky = sky * (1 + 0.4 * np.sin(3 * azimuth) * np.cos(2 * w[:, 1]))[:, None]
    lamp = np.array([0.5, 0.6, -0.62]) / np.linalg.norm([0.5, 0.6, -0.62])
    return sky + 12 * np.exp(40 * (w @ lamp - 1))[:, None] * np.array([1.0, 0.9, 0.7])


def backdrop(w: np.ndarray) -> np.ndarray:
    """Wallpaper behind the ball."""
    pattern = np.sin(38 * w[:, :1]) * np.sin(31 * w[:, 1:2] + 1)
    return (0.15 + 0.1 * pattern) * np.array([[1.0, 0.8, 0.6]])


def map_of(light: Light, height: int) -> torch.Tensor:
    """The light averaged over each pixel."""
    fine = DirectionGrid.latlong(4 * height).directions.numpy()
    radiance = torch.from_numpy(light(fine)).reshape(4 * height, 8 * height, 3)
    return EnvironmentMap(radiance=radiance).resize(height).radiance


def true_ball(middle: tuple[float, float] = MIDDLE, distance: float = DISTANCE) -> Ball:
    axis = ray(middle, SIZE, FOCAL_PX)
    camera = picture_camera(*SIZE, FOCAL_PX)
    return Ball(
        camera=camera, axis=axis / np.linalg.norm(axis), half_angle_rad=math.asin(1 / distance)
    )


def picture_of(light: Light, turn: np.ndarray | None = None, samples: int = 2) -> np.ndarray:
    return photograph(
        light,
        size=SIZE,
        focal_px=FOCAL_PX,
        middle=MIDDLE,
        distance=DISTANCE,
        radius=1.0,
        backdrop=backdrop,
        turn=turn,
        samples=samples,
    )


def view_of(picture: np.ndarray, clipped: np.ndarray | None = None) -> BallView:
    mask = np.zeros(SIZE, bool) if clipped is None else clipped
    return BallView(
        radiance=torch.from_numpy(picture.astype(np.float32)),
        clipped=torch.from_numpy(mask),
        ball=true_ball(),
    )


@dataclass(frozen=True, kw_only=True)
class Made:
    """The light round a ball and a picture of it."""

    picture: np.ndarray
    radiance: torch.Tensor


@cache
def make() -> Made:
    return Made(picture=picture_of(made_light, samples=3), radiance=map_of(made_light, 32))


@pytest.fixture
def made() -> Made:
    return make()
