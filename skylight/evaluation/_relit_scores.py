"""Relit pictures beside the true ones: their exposure, the baseline, scores and strips.

The baseline is a global transfer of colour between pictures (Reinhard et al. 2001).
"""

import math

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray
from skimage.color import lab2rgb, rgb2lab
from skimage.metrics import structural_similarity

from skylight.evaluation._pictures import Picture, caption, sized
from skylight.evaluation._run import Item
from skylight.faces._fit import FaceFit
from skylight.faces._model import HeadModel
from skylight.imaging._colour import linear_to_srgb, srgb_to_linear
from skylight.transport._rays import Raycaster
from skylight.transport._render import rasterize

RELIT, TRANSFER, UNCHANGED = "relit", "transfer", "unchanged"
PHOTOGRAPH, TRUTH = "photograph", "truth"  # in the strips, beside the rows
TILE = 200  # pixels of a picture's width in the strips
EXPOSURES = np.exp2(np.linspace(-2, 2, 81))  # about that of equal means of linear values
BLOTCH_PX, BLOTCH_PERCENTILE = 9, 99.0
LEAST_RMSE = 1 / 255 / math.sqrt(12)  # what rounding to 8 bits leaves: 59 dB


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


def best_exposed(
    linear: Float[ndarray, "h w 3"], truth: Float[ndarray, "h w 3"], mask: Bool[ndarray, "h w"]
) -> Float[ndarray, "h w 3"]:
    """A linear picture as sRGB values, at the factor of :data:`EXPOSURES` that is nearest to the
    truth."""
    seen, wanted = linear[mask], truth[mask]
    bright = float(srgb_to_linear(torch.from_numpy(wanted)).mean())
    level = bright / max(float(np.maximum(seen, 0).mean()), 1e-6)
    errors = [float(np.square(encoded(level * k * seen) - wanted).mean()) for k in EXPOSURES]
    return encoded(level * float(EXPOSURES[int(np.argmin(errors))]) * linear)


def encoded(linear: Float[ndarray, "*s"]) -> Float[ndarray, "*s"]:
    return linear_to_srgb(torch.from_numpy(np.clip(linear, 0, 1)).float()).numpy()


def score(
    picture: Float[ndarray, "h w 3"],
    truth: Float[ndarray, "h w 3"],
    mask: Bool[ndarray, "h w"],
    suffix: str = "",
) -> dict[str, float]:
    """Of sRGB values from 0 to 1, over a mask, under names that end with the suffix.

    Root mean square error, the same in dB below 1, the mean of local SSIM (windows of 7 x 7), and
    blotches: the 99th percentile over the mask of the absolute error, averaged over channels and
    the mask's pixels in a box of 9 x 9.
    """
    # with full=True it answers (mean, map)
    similar = np.asarray(
        structural_similarity(picture, truth, channel_axis=2, data_range=1.0, full=True)[1]
    )
    rmse = float(np.sqrt(np.square(picture - truth)[mask].mean()))
    inside = mask.astype(np.float32)
    errors, count = (
        cv2.blur(part, (BLOTCH_PX, BLOTCH_PX), borderType=cv2.BORDER_CONSTANT)[mask]
        for part in (np.abs(picture - truth).mean(2).astype(np.float32) * inside, inside)
    )
    scores = {
        "srgb_rmse": rmse,
        "srgb_psnr": -20 * math.log10(max(rmse, LEAST_RMSE)),
        "srgb_ssim": float(similar[mask].mean()),
        "blotch": float(np.percentile(errors / count, BLOTCH_PERCENTILE)),
    }
    return {name + suffix: value for name, value in scores.items()}


def mean_over(items: list[Item], metric: str, other: str) -> float:
    """Our mean over that of another row, over the items which have both."""
    both = [item.metrics for item in items if other in item.metrics]
    ours, theirs = (np.mean([rows[name][metric] for rows in both]) for name in (RELIT, other))
    return float(ours / theirs)


def head_mask(fit: FaceFit) -> Bool[ndarray, "h w"]:
    """Where a picture shows the head of that fit, neck included."""
    vertices = torch.from_numpy(fit.vertices)
    faces = torch.from_numpy(HeadModel.load().faces.copy())
    surface = rasterize(fit.camera, vertices, faces, Raycaster(vertices, faces))
    return surface.image(torch.ones(len(surface), 1))[..., 0].numpy() > 0


def compared(pictures: dict[str, Float[ndarray, "h w 3"]]) -> Picture:
    """sRGB pictures from 0 to 1 beside each other, each with its name above."""
    tiles = []
    for name, one in pictures.items():
        codes = np.round(255 * one).astype(np.uint8)
        height = round(TILE * one.shape[0] / one.shape[1])
        tiles.append(np.vstack([caption(name, TILE), sized(codes, TILE, height)]))
    return np.hstack(tiles)
