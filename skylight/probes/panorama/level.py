"""The world of a panorama: upright, with the first shot ahead, or as hints say."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from skylight.cameras.turns import best_rotation

_TOLD = 0.02  # of the shots' number: least spread of their right-hand sides that tells the vertical
_STEEP = 0.9  # sine of the elevation above which a shot tells no azimuth


def levelled(
    rotations: dict[int, Float[np.ndarray, "3 3"]],
) -> dict[int, Float[np.ndarray, "3 3"]]:
    """The same rotations, turned together: +Y up, -Z where the first shot looks, or near that.

    Nobody rolls the camera much, so all shots' right-hand sides lie in the horizontal plane: its
    normal is the direction in which they vary least (Brown & Lowe 2007, section 5). Shots that do
    not turn far enough to the side tell no vertical: then it is the first one's own.
    """
    shots = sorted(rotations)
    frames = np.array([rotations[shot] for shot in shots])
    right, up = frames[:, :, 0], frames[:, :, 1]
    spread, axes = np.linalg.eigh(right.T @ right)
    vertical = axes[:, 0] if spread[1] > _TOLD * len(shots) else up[0]
    vertical = vertical * (1.0 if up.sum(0) @ vertical > 0 else -1.0)
    ahead = -frames[:, :, 2]
    level = np.flatnonzero(np.abs(ahead @ vertical) < _STEEP)
    # a shot at the zenith has ahead what it has below the picture's lower edge
    towards = ahead[level[0]] if len(level) else -np.sign(ahead[0] @ vertical) * up[0]
    back = -(towards - (towards @ vertical) * vertical)
    back /= np.linalg.norm(back)
    upright = np.stack([np.cross(vertical, back), vertical, back])
    return {shot: upright @ rotations[shot] for shot in shots}


def aligned(
    rotations: Mapping[int, Float[np.ndarray, "3 3"]],
    hints: Mapping[int, Float[np.ndarray, "3 3"]],
) -> dict[int, Float[np.ndarray, "3 3"]]:
    """The same rotations, turned together to meet the hints best, in the least-squares sense."""
    both = [shot for shot in rotations if shot in hints]
    turn = best_rotation(np.sum([hints[shot] @ rotations[shot].T for shot in both], axis=0))
    return {shot: turn @ rotations[shot] for shot in rotations}


def hinted(azimuth_deg: float, elevation_deg: float) -> Float[np.ndarray, "3 3"]:
    """World from camera: turned to the right from -Z, then up, without roll."""
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    turned = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
    raised = np.array([[1, 0, 0], [0, np.cos(e), -np.sin(e)], [0, np.sin(e), np.cos(e)]])
    return turned @ raised
