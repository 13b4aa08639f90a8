"""Segmentation of bare skin: no hair, beard, glasses, hats or clothes.

Skin's colour differs between places by how much of sun and sky each gets, so a pixel is compared
with the face's own skin in the logarithms of its ratios red : green and blue : green, and in how
rough it is: hair and cloth have detail where skin is smooth.
"""

from dataclasses import dataclass

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


@dataclass(frozen=True, kw_only=True)
class SkinLikeness:
    """How a picture compares with the skin of the ``face`` in it (a mask).

    Where ``clipped`` (over-exposed) a pixel has lost its colour and its detail.
    """

    face: Bool[ndarray, "h w"]
    clipped: Bool[ndarray, "h w"]
    colour_distance: Float[ndarray, "h w"]
    roughness: Float[ndarray, "h w"]
    brightness: Float[ndarray, "h w"]

    @staticmethod
    def of(
        image: Float[ndarray, "h w 3"], face: Bool[ndarray, "h w"], clipped: Bool[ndarray, "h w"]
    ) -> "SkinLikeness":
        """Of a linear picture; some of the face must not be clipped."""
        exact, green = face & ~clipped, image[..., 1]
        detail = roughness(image)
        return SkinLikeness(
            face=face,
            clipped=clipped,
            colour_distance=colour_distance(image, exact),
            roughness=detail / max(float(np.quantile(detail[exact], 0.8)), _EPSILON),
            brightness=green / max(float(np.median(green[exact])), _EPSILON),
        )

    def bare(
        self, head: Bool[ndarray, "h w"], part: Bool[ndarray, "h w"], darkest: float
    ) -> Bool[ndarray, "h w"]:
        """The pixels of ``part`` that show bare skin; ``head`` is where skin may be at all.

        Pixels darker than ``darkest`` times the face's median are left out, and so are those that
        are cut off from the face by others: a hairline or a collar is an edge. Where less than
        half of what is not clipped in ``part`` looks like skin, what does is taken for chance and
        nothing is returned.
        """
        exact = part & ~self.clipped
        alike = (
            (self.colour_distance < FARTHEST)
            & (self.roughness < ROUGHEST)
            & (self.brightness > darkest)
        ) & ~self.clipped
        # what is white goes with its neighbours, whose border with it is an edge of their own
        white = cv2.dilate((self.clipped & head).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        passable = head & (alike | white) | self.face
        _, label = cv2.connectedComponents(passable.astype(np.uint8), connectivity=4)
        joined = np.isin(label, np.unique(label[self.face]))
        if not exact.any() or (alike & exact & joined).sum() < LEAST_PART * exact.sum():
            return np.zeros_like(part)
        return part & joined & (alike | self.clipped)


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
    """Detail: ``|ln green - its mean over 5 x 5 pixels|``, averaged over 3 x 3."""
    log = np.log(image[..., 1].clip(_EPSILON)).astype(np.float32)
    return cv2.blur(np.abs(log - cv2.blur(log, (5, 5))), (3, 3))
