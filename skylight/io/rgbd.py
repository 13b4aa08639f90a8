"""High dynamic range in 8-bit RGBA: colours times D, with D as alpha.

As Babylon.js reads it (helperFunctions, fromRGBD): ``rgb = (code / 255)^2.2 / D``, ``D = alpha``,
which is what EXT_lights_image_based calls RGBD; that text leaves the curve open.
"""

import numpy as np
from jaxtyping import Float, UInt8

LARGEST = 255.0  # what the smallest D, 1 / 255, can stand for
_GAMMA = 2.2


def encode_rgbd(rgb: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 4"]:
    """D = floor(255 / max(R, G, B)) / 255, at most 1: the largest that keeps the colour below 1.

    The relative error of the largest channel is below 1 % where it exceeds 0.5 (a code in 255 of
    the 2.2th root), growing to 5 % at 0.02. Values above 255 must be scaled down before.
    """
    if rgb.size and rgb.max() > LARGEST:
        raise ValueError(f"RGBD holds values up to {LARGEST:g}, got {rgb.max():.6g}: scale it down")
    peak = np.maximum(rgb.max(-1, keepdims=True), 1.0)
    alpha = np.floor(255.0 / peak)
    held = np.clip(rgb * (alpha / 255.0), 0.0, 1.0) ** (1 / _GAMMA)
    return np.concatenate([np.rint(255.0 * held), alpha], -1).astype(np.uint8)
