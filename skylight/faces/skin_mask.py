"""Which pixels of a head show bare skin: no hair, beard, glasses, hats or clothes.

Skin's colour differs between places by how much of sun and sky each gets, so a pixel is compared
with the face's own skin in the logarithms of its ratios red : green and blue : green, and in how
rough it is: hair and cloth have detail where skin is smooth.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

# Spread of skin's colour over a face under one light, in the log of a ratio of channels: blood and
# melanin vary by about 0.05, sun against sky by more in blue than in red.
LEAST_SPREAD = np.array([0.05, 0.07])
FARTHEST = 2.5  # spreads from the face's median colour
ROUGHEST = 1.5  # times the detail of the face's 80th percentile
LEAST_PART = 0.5  # of a part of the head that looks like skin, else none of it is used
_EPSILON = 1e-4


def skin_like(
    image: Float[ndarray, "h w 3"],
    face: Bool[ndarray, "h w"],
    head: Bool[ndarray, "h w"],
    part: Bool[ndarray, "h w"],
    darkest: float,
) -> Bool[ndarray, "h w"]:
    """The pixels of ``part`` that look like those of ``face``, which most show skin.

    All are masks over the linear ``image``; ``head`` is where skin may be at all. Pixels darker
    than ``darkest`` times the face's median are left out, and so are those that are cut off from
    the face by others: a hairline or a collar is an edge. Where less than half of ``part`` looks
    like skin, what does is taken for chance and nothing is returned.
    """
    if not part.any():
        return part
    detail, green = roughness(image), image[..., 1]
    alike = (
        (colour_distance(image, face) < FARTHEST)
        & (detail < ROUGHEST * np.quantile(detail[face], 0.8))
        & (green > darkest * np.median(green[face]))
    )
    _, label = cv2.connectedComponents((head & alike | face).astype(np.uint8), connectivity=4)
    alike &= part & np.isin(label, np.unique(label[face]))
    if alike.sum() < LEAST_PART * part.sum():
        return np.zeros_like(part)
    return alike


def colour_distance(
    image: Float[ndarray, "h w 3"], face: Bool[ndarray, "h w"]
) -> Float[ndarray, "h w"]:
    """How far a pixel's colour is from the face's median, in its spreads (the larger of two).

    Spreads are 1.4826 median absolute deviations, ``LEAST_SPREAD`` at least.
    """
    logs = np.log(image.clip(_EPSILON))
    colour = logs[..., [0, 2]] - logs[..., 1:2]
    middle = np.median(colour[face], axis=0)
    deviation = np.abs(colour - middle)
    spread = np.maximum(1.4826 * np.median(deviation[face], axis=0), LEAST_SPREAD)
    return (deviation / spread).max(-1)


def roughness(image: Float[ndarray, "h w 3"]) -> Float[ndarray, "h w"]:
    """Detail: |ln of the green channel less its mean over 5 x 5 pixels|, averaged over 3 x 3."""
    log = np.log(image[..., 1].clip(_EPSILON)).astype(np.float32)
    return cv2.blur(np.abs(log - cv2.blur(log, (5, 5))), (3, 3))
