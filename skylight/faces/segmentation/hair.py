"""Hair, by MediaPipe's segmentation network (Tkachenka et al. 2019)."""

import cv2
import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from skylight.faces.detection.blazeface import Square
from skylight.faces.detection.networks import network
from skylight.imaging.colour import tone_map


def hair_probability(picture: Float[Tensor, "h w 3"], square: Square) -> Float[ndarray, "h w"]:
    """How likely each pixel of a linear picture shows hair; 0 outside of ``square``.

    The network sees the square as 512 x 512 sRGB codes from 0 to 1, and in a fourth channel the
    mask of the film's previous picture, which is none here. Of the two logits that it gives for
    each pixel, the second is hair's.
    """
    segmenter = network("hair_segmenter")
    side = segmenter.side
    # in linear values, so that codes are those of the light that falls on a larger pixel
    seen = tone_map(torch.from_numpy(square.cut(picture.numpy(), side, cv2.BORDER_REPLICATE)))
    shown = np.dstack([seen / np.float32(255), np.zeros((side, side), np.float32)])
    (logits,) = segmenter.run(shown)
    probability = 1 / (1 + np.exp(logits[0, ..., 0] - logits[0, ..., 1]))
    return square.paste(probability, *picture.shape[:2])
