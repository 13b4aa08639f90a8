"""A virtual camera that turns in known light: shots with photon noise, brackets and codes."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from skylight.imaging._colour import linear_to_srgb
from skylight.probes.cameras._exposures import Exposure
from skylight.probes.panorama._matches import Lens
from skylight.probes.panorama._panorama import rotation_to
from skylight.sphere._envmap import EnvironmentMap, bilinear
from skylight.sphere._frame import pixel_from_direction

Light = Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, "n 3"]]
_SAMPLES = 3  # along each side of a pixel
_ELECTRONS = 20_000.0  # of a pixel that is full
_READ_ELECTRONS = 5.0


@dataclass(frozen=True)
class Head:
    """Directions of a tripod's head: ``columns`` azimuths at each elevation, row by row.

    Turns are wrong by a normal ``error_deg`` about each axis, which the camera does not tell.
    """

    columns: int
    elevations_deg: tuple[float, ...]
    error_deg: float = 2.0

    def told(self) -> list[Float[np.ndarray, "3 3"]]:
        """Where the camera should have looked, world from camera."""
        return [rotation_to(a, e) for a, e in self.angles_deg()]

    def angles_deg(self) -> list[tuple[float, float]]:
        """(azimuth, elevation) of each shot."""
        step = 360 / self.columns
        return [(c * step, e) for e in self.elevations_deg for c in range(self.columns)]

    def true(self, rng: np.random.Generator) -> list[Float[np.ndarray, "3 3"]]:
        """Where it looked."""
        told = self.told()
        off = np.radians(self.error_deg) * rng.standard_normal((len(told), 3))
        return [
            turn @ Rotation.from_rotvec(each).as_matrix()
            for turn, each in zip(told, off, strict=True)
        ]


def light_of(environment: EnvironmentMap) -> Light:
    """The radiance of a map, bilinear between its pixels."""
    height, width = environment.layout
    radiance = environment.radiance.double()

    def look(directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        row, column = pixel_from_direction(torch.from_numpy(directions), height, width)
        return bilinear(radiance, row, column).numpy()

    return look


def picture(
    light: Light, rotation: Float[np.ndarray, "3 3"], lens: Lens
) -> Float[np.ndarray, "h w 3"]:
    """Radiance at each pixel, the mean of 3 x 3 rays through it."""
    inside = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    total = np.zeros((lens.height, lens.width, 3))
    x, y = np.meshgrid(np.arange(lens.width), np.arange(lens.height))
    for dx in inside:
        for dy in inside:
            places = np.stack([x + dx, y + dy], -1).reshape(-1, 2)
            total += light(lens.rays(places) @ rotation.T).reshape(total.shape)
    return total / _SAMPLES**2


def expose(
    radiance: Float[np.ndarray, "h w 3"],
    seconds: float,
    rng: np.random.Generator,
    bits: int,
    name: str,
) -> Exposure:
    """An exposure in which 1 / ``seconds`` fills a pixel: with noise, cut off, in whole codes.

    8 bits are sRGB, 16 are linear, as a RAW file is developed.
    """
    electrons = _ELECTRONS * radiance * seconds
    spread = np.sqrt(electrons + _READ_ELECTRONS**2)
    share = np.clip((electrons + spread * rng.standard_normal(spread.shape)) / _ELECTRONS, 0, 1)
    if bits == 8:
        codes = np.rint(255 * linear_to_srgb(torch.from_numpy(share)).numpy())
        return Exposure(name=name, seconds=seconds, image=codes.astype(np.uint8))
    linear = np.rint(65535 * share) / 65535
    return Exposure(name=name, seconds=seconds, image=linear.astype(np.float32))


def bracket(brightest: float, usual: float, stops: float = 2.0) -> tuple[float, ...]:
    """Times from one that holds ``brightest`` to one at which ``usual`` is half of full.

    In equal steps of at most so many ``stops``.
    """
    shortest, longest = 0.7 / brightest, 0.5 / usual
    count = max(2, 1 + math.ceil(math.log2(longest / shortest) / stops))
    return tuple(np.geomspace(shortest, longest, count).tolist())
