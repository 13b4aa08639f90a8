"""Linear radiance as 8-bit pixels."""

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.imaging.colour import linear_to_srgb
from skylight.sphere.envmap import luminance


def white_of(values: Float[Tensor, "m 3"]) -> float:
    """The luminance to show as white: a little above nearly all."""
    return max(1.05 * float(torch.quantile(luminance(values.float()), 0.98)), 1e-30)


def srgb_codes(linear: Float[Tensor, "h w 3"], white: float) -> UInt8[np.ndarray, "h w 3"]:
    """Linear Rec.709 over the luminance ``white``, clipped, as 8-bit sRGB."""
    return (255 * linear_to_srgb((linear / white).clamp(0, 1))).round().to(torch.uint8).numpy()
