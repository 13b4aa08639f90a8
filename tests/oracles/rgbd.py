"""RGBD as Babylon.js reads it (helperFunctions, fromRGBD)."""

import numpy as np


def decode_rgbd(codes: np.ndarray) -> np.ndarray:
    """(h, w, 4) codes to (h, w, 3) radiance."""
    return (codes[..., :3] / 255.0) ** 2.2 / (codes[..., 3:] / 255.0)
