"""Light that saturates even the shortest exposure."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from skimage.measure import label

from skylight.probes.radiance.probe_map import ProbeMap
from skylight.sphere.envmap import luminance
from skylight.sphere.frame import angles_from_direction

# Of the sun's disc, 0.533 degrees across at the mean distance: pi (0.2665 pi / 180)^2.
SUN_SR = math.pi * math.radians(0.2665) ** 2
_COUNTS = 0.02  # share of a pixel from which it counts as a part of a region


@dataclass(frozen=True, kw_only=True)
class Clipping:
    """Light at which the shortest exposure is saturated.

    ``solid_angle_sr``
        of all of it.
    ``regions``
        how many there are.
    ``azimuth_deg``, ``zenith_deg``
        middle of the largest.
    ``light_share``
        of the light from all directions, the share that is counted there. It is counted at the
        level of saturation, so the true share is at least this.
    ``radiance_sr``
        sum of L dw over it, red, green and blue; the true one is at least this.
    """

    solid_angle_sr: float
    regions: int
    azimuth_deg: float
    zenith_deg: float
    light_share: float
    radiance_sr: tuple[float, float, float]

    def sentence(self) -> str:
        """For the user."""
        suns = self.solid_angle_sr / SUN_SR
        return (
            f"the shortest exposure is saturated over {self.solid_angle_sr:.2g} sr "
            f"({suns:.2g} times the sun's disc), mostly at azimuth {self.azimuth_deg:.0f}, zenith "
            f"{self.zenith_deg:.0f} degrees: that light counts with "
            f"{100 * self.light_share:.2g} % of all, and is more by an unknown factor; "
            "take shorter exposures"
        )


def find_clipping(probe: ProbeMap) -> Clipping | None:
    """What is clipped of a map; None where nothing is."""
    share = probe.clipped.numpy().astype(np.float64)
    if not (share > _COUNTS).any():
        return None
    labels, count = _regions(share > _COUNTS)
    environment = probe.environment
    grid = environment.grid
    weight = share.ravel() * grid.solid_angles.numpy() * (labels.ravel() > 0)
    sizes = np.bincount(labels.ravel(), weight)
    largest = int(sizes[1:].argmax()) + 1
    inside = torch.from_numpy(weight * (labels.ravel() == largest))
    azimuth, zenith = angles_from_direction(inside @ grid.directions)
    held = torch.from_numpy(weight) @ environment.flat.double()
    total = environment.integrate().double()
    return Clipping(
        solid_angle_sr=float(weight.sum()),
        regions=count,
        azimuth_deg=math.degrees(float(azimuth)),
        zenith_deg=math.degrees(float(zenith)),
        light_share=float(luminance(held) / luminance(total).clamp(min=1e-30)),
        radiance_sr=(float(held[0]), float(held[1]), float(held[2])),
    )


def _regions(mask: np.ndarray) -> tuple[np.ndarray, int]:
    """Labels from 1 of connected pixels, and their number.

    Pixels connect across the left and right edge as well, and all of the first and of the last row
    at a pole, where they meet.
    """
    labels = np.asarray(label(mask, connectivity=1))
    for row in (labels[0], labels[-1]):
        labels[np.isin(labels, row[row > 0])] = row.max()
    for row in labels:
        left, right = row[0], row[-1]
        if left and right:
            labels[labels == right] = left
    kinds, numbers = np.unique(labels, return_inverse=True)
    # 0, the background, may be missing
    return numbers.reshape(labels.shape) + (kinds[0] != 0), int((kinds != 0).sum())
