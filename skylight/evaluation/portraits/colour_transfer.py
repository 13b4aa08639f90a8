"""Global colour transfer between pictures, the baseline of relighting (Reinhard et al. 2001)."""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from skimage.color import lab2rgb, rgb2lab


def colour_transfer(
    picture: Float[ndarray, "h w 3"],
    target: Float[ndarray, "h w 3"],
    mask: Bool[ndarray, "h w"],
) -> Float[ndarray, "h w 3"]:
    """An sRGB picture (0 to 1) with the mean and deviation of ``target`` under the mask.

    Each channel of CIELAB by itself, where Reinhard et al. take their l-alpha-beta.
    """
    own, wanted = rgb2lab(picture), rgb2lab(target)
    deviation = np.maximum(own[mask].std(0), 1e-6)
    moved = (own - own[mask].mean(0)) / deviation * wanted[mask].std(0) + wanted[mask].mean(0)
    with np.errstate(invalid="ignore"):
        return np.clip(lab2rgb(moved), 0, 1).astype(np.float32)
