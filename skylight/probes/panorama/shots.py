"""The shots of a turning camera: merged exposures at a working size, and what features see."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from skylight.probes.radiance.exposures import Merged
from skylight.sphere.envmap import LUMINANCE

WORKING_SIDE = 1000  # px of the longer side: maps of up to 1024 rows show no more of a usual lens
_DARK_SHARE = 0.02  # quantiles of log luminance that become black and white for features
_FLOOR = 1e-6  # of the brightest: what is darker counts as that dark


@dataclass(frozen=True, kw_only=True)
class Shot:
    """What the camera saw in one direction, scaled down to :data:`WORKING_SIDE` at most.

    ``radiance`` is linear light in one unit for all shots, ``clipped`` the share of each pixel
    that saturates even the shortest exposure, and ``width`` that of the picture as it was taken.
    """

    name: str
    radiance: Float[np.ndarray, "h w 3"]
    clipped: Float[np.ndarray, "h w"]
    width: int

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of ``radiance``."""
        return self.radiance.shape[1], self.radiance.shape[0]

    @property
    def light(self) -> Float[np.ndarray, "h w"]:
        """Luminance."""
        return self.radiance @ np.array(LUMINANCE, np.float32)

    @property
    def scale(self) -> float:
        """Pixels of ``radiance`` per pixel of the picture."""
        return self.radiance.shape[1] / self.width


def shot_of(name: str, merged: Merged, gain: float = 1.0) -> Shot:
    """A shot of merged exposures, times ``gain``, scaled down by areas: light is kept."""
    radiance, clipped = merged.radiance.numpy(), merged.clipped.numpy().astype(np.float32)
    height, width = clipped.shape
    scale = min(1.0, WORKING_SIDE / max(width, height))
    size = max(1, round(scale * width)), max(1, round(scale * height))
    return Shot(
        name=name,
        radiance=gain * cv2.resize(radiance, size, interpolation=cv2.INTER_AREA),
        clipped=cv2.resize(clipped, size, interpolation=cv2.INTER_AREA),
        width=width,
    )


def for_features(shot: Shot) -> UInt8[np.ndarray, "h w"]:
    """Log luminance as 8-bit grey: edges in shadows count as much as those in the light."""
    light = shot.light
    logs = np.log(np.maximum(light, _FLOOR * light.max() + 1e-30))
    dark, bright = np.quantile(logs, (_DARK_SHARE, 1 - _DARK_SHARE))
    return np.clip(np.rint(255 * (logs - dark) / max(bright - dark, 1e-3)), 0, 255).astype(np.uint8)
