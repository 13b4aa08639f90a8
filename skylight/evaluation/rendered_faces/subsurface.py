"""Subsurface scattering as a blur in image space.

An approximation in the manner of d'Eon & Luebke 2007 ("Advanced Techniques for Realistic Real-Time
Skin Rendering", GPU Gems 3, chapter 14): what leaves diffusely is the irradiance spread by a sum of
Gaussians, times the albedo. Here the spreading happens in the picture: skin that is seen at a slant
is spread too far across, light does not come through from sides that the camera does not see, and
light that entered outside the picture is missing.
"""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.special import ndtr

# variance in mm^2, and the share of red, green and blue: d'Eon & Luebke, figure 14-13
PROFILE = (
    (0.0064, (0.233, 0.455, 0.649)),
    (0.0484, (0.100, 0.336, 0.344)),
    (0.187, (0.118, 0.198, 0.0)),
    (0.567, (0.113, 0.007, 0.007)),
    (1.99, (0.358, 0.004, 0.0)),
    (7.41, (0.078, 0.0, 0.0)),
)
_REACH_MM = 6.0
_DEPTH_MM = 8.0  # skin further apart in depth than this is not connected


def kernel(px_per_mm: float, reach: int) -> Float[ndarray, "k k 3"]:
    """The profile integrated over pixels, k = 2 ``reach`` + 1, of sum 1 per channel or less."""
    edges = np.arange(-reach - 0.5, reach + 1)
    out = np.zeros((2 * reach + 1, 2 * reach + 1, 3))
    for variance, share in PROFILE:
        line = np.diff(ndtr(edges / (np.sqrt(variance) * px_per_mm)))
        out += line[:, None, None] * line[None, :, None] * np.array(share)
    return out


def scattered(
    irradiance: Float[ndarray, "h w 3"],
    depth_m: Float[ndarray, "h w"],
    skin: Bool[ndarray, "h w"],
    focal_px: float,
) -> Float[ndarray, "h w 3"]:
    """x_i + sum_j k_ij (x_j - x_i), over the pixels j of skin near i in the picture and in depth.

    As k_ij = k_ji, the sum over all pixels stays the same to rounding, and so does an even light:
    what would cross an edge stays where it was. The scale is that of the skin's median depth.
    """
    if not skin.any():
        return irradiance
    px_per_mm = focal_px / (1000 * float(np.median(depth_m[skin])))
    reach = max(1, round(_REACH_MM * px_per_mm))
    weights = kernel(px_per_mm, reach)
    height, width = skin.shape
    out = irradiance.astype(np.float64)
    for down in range(reach + 1):
        for right in range(-reach if down else 1, reach + 1):
            k = weights[reach + down, reach + right]
            if k.max() < 1e-5:
                continue
            left, over = max(0, -right), max(0, right)
            a = np.s_[: height - down, left : width - over]
            b = np.s_[down:, over : width - left]
            joined = skin[a] & skin[b] & (np.abs(depth_m[a] - depth_m[b]) < _DEPTH_MM / 1000)
            moved = (irradiance[b] - irradiance[a]) * joined[..., None] * k
            out[a] += moved
            out[b] -= moved
    return out
