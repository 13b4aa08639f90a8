"""Pictures of which only some pixels are known: blurred, and filled smoothly."""

import cv2
import numpy as np
from jaxtyping import Float, Float32, Shaped
from numpy import ndarray


def blurred(
    picture: Float[ndarray, "h w c"], weights: Float[ndarray, "h w"], sigma_px: float
) -> Float[ndarray, "h w c"]:
    """Normalised convolution (Knutsson and Westin 1993): ``G * (w x) / G * w``, G a Gaussian.

    Where no pixel of weight lies near, it tends to 0.
    """
    above = cv2.GaussianBlur(float32(picture * weights[..., None]), (0, 0), sigma_px)
    below = cv2.GaussianBlur(float32(weights), (0, 0), sigma_px)
    return above.reshape(picture.shape) / np.maximum(below, 1e-6)[..., None]


def filled(
    picture: Float[ndarray, "h w c"], weights: Float[ndarray, "h w"]
) -> Float[ndarray, "h w c"]:
    """What weights of 0 to 1 leave unknown, from its surroundings by push and pull (Gortler et al.
    1996): weighted means of ever larger neighbourhoods, interpolated back where detail lacks.

    Raises
    ------
    ValueError
        Nothing is known.
    """
    if not weights.any():
        raise ValueError("no pixel of the picture is known")
    if min(weights.shape) < 2:
        mean = np.average(picture.reshape(-1, picture.shape[2]), 0, weights.reshape(-1))
        return np.where(weights[..., None] > 0, picture, mean)
    pushed = cv2.pyrDown(float32(picture * weights[..., None]))
    below = cv2.pyrDown(float32(weights))
    coarse = pushed.reshape(*below.shape, -1) / np.maximum(below, 1e-12)[..., None]
    pulled = cv2.pyrUp(
        float32(filled(coarse, np.minimum(4 * below, 1))), dstsize=picture.shape[1::-1]
    )
    known = weights[..., None]
    return known * picture + (1 - known) * pulled.reshape(picture.shape)


def float32(picture: Shaped[ndarray, "*s"]) -> Float32[ndarray, "*s"]:
    """As OpenCV takes it."""
    return np.ascontiguousarray(picture, np.float32)
