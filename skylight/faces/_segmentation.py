"""Segmentation of photographs of people: bare skin, hair, and a soft matte of the person.

Skin (:class:`SkinLikeness`) is bare where there is no hair, beard, glasses, hats or clothes. Its
colour differs between places by how much of sun and sky each gets, so a pixel is compared
with the face's own skin in the logarithms of its ratios red : green and blue : green, and in how
rough it is: hair and cloth have detail where skin is smooth. Hair is found by MediaPipe's
segmentation network (Tkachenka et al. 2019). The matte grows from head, hair and bust, and follows
the picture's edges.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray
from torch import Tensor

from skylight.faces._blazeface import Square, network
from skylight.imaging._colour import tone_map

# Spread of skin's colour over a face under one light, in the log of a ratio of channels: blood and
# melanin vary by about 0.05, sun against sky by more in blue than in red.
LEAST_SPREAD = np.array([0.05, 0.07])
FARTHEST = 2.5  # spreads from the face's median colour
ROUGHEST = 1.5  # times the detail of the face's 80th percentile
LEAST_PART = 0.5  # of a part of the head that looks like skin, else none of it is used
_LEAST = 1e-4  # of values, before logarithms and divisions
# Of the matte; lengths are in heights of the face.
SURE = 0.03  # of the head's border: what lies deeper is the person's for certain
SURE_BUST = 0.15  # of a bust that fits nobody exactly
REACH = 0.35  # about head, hair and bust: what lies farther out is background for certain
FEATHER = 0.015  # radius of the guided filter
_EPSILON = 1e-4  # of the guided filter, for values from 0 to 1
_HAIR, _SURE_HAIR = 0.5, 0.8
_GRABCUT_ITERATIONS = 4


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
            roughness=detail / max(float(np.quantile(detail[exact], 0.8)), _LEAST),
            brightness=green / max(float(np.median(green[exact])), _LEAST),
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
    logs = np.log(image.clip(_LEAST))
    colour = logs[..., [0, 2]] - logs[..., 1:2]
    middle = np.median(colour[face], axis=0)
    deviation = np.abs(colour - middle)
    spread = np.maximum(1.4826 * np.median(deviation[face], axis=0), LEAST_SPREAD)
    return (deviation / spread).max(-1)


def roughness(image: Float[ndarray, "h w 3"]) -> Float[ndarray, "h w"]:
    """Detail: ``|ln green - its mean over 5 x 5 pixels|``, averaged over 3 x 3."""
    log = np.log(image[..., 1].clip(_LEAST)).astype(np.float32)
    return cv2.blur(np.abs(log - cv2.blur(log, (5, 5))), (3, 3))


def person_matte(
    encoded: UInt8[ndarray, "h w 3"],
    head: Bool[ndarray, "p q"],
    bust: Bool[ndarray, "p q"],
    hair: Float32[ndarray, "p q"],
    face_px: float,
    before: Float[ndarray, "h w"] | None = None,
) -> Float32[ndarray, "h w"]:
    """How much of each pixel of an sRGB picture is a person, from 0 to 1.

    ``head``, ``bust`` and how likely there is ``hair`` are masks of the same picture at a size at
    which the face is ``face_px`` high. There the person is cut out by GrabCut (Rother et al. 2004),
    which learns the colours of what is sure and decides about the rest; of its result the part
    that holds the head is kept, and its border follows the picture's edges by a guided filter (He
    et al. 2013). Same input, same matte.

    ``before`` is a film's last matte, moved to where things are in this picture: GrabCut starts
    from it where nothing is sure, and so ends beside it.
    """
    size = head.shape[::-1]
    small = cv2.resize(encoded, size, interpolation=cv2.INTER_AREA)
    labels = np.full(head.shape, cv2.GC_BGD, np.uint8)
    labels[_grown(head | bust | (hair > _HAIR), REACH * face_px)] = cv2.GC_PR_BGD
    labels[_grown(head | (hair > _HAIR), SURE * face_px) | bust] = cv2.GC_PR_FGD
    if before is not None:
        was = cv2.resize(before.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
        labels[was & (labels == cv2.GC_PR_BGD)] = cv2.GC_PR_FGD
        labels[~was & (labels == cv2.GC_PR_FGD)] = cv2.GC_PR_BGD
    labels[hair > _SURE_HAIR] = cv2.GC_FGD
    labels[_shrunk(head, SURE * face_px) | _shrunk(bust, SURE_BUST * face_px)] = cv2.GC_FGD
    if not np.isin(labels, (cv2.GC_BGD, cv2.GC_PR_BGD)).any():
        return np.ones(encoded.shape[:2], np.float32)
    cv2.setRNGSeed(0)  # its k-means starts at random
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(
        np.ascontiguousarray(small[..., ::-1]),
        labels,
        (0, 0, 0, 0),  # of a rectangle to start from: the mask does
        *models,
        _GRABCUT_ITERATIONS if before is None else 1,
        cv2.GC_INIT_WITH_MASK,
    )
    inside = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))
    _, parts = cv2.connectedComponents(inside.astype(np.uint8))
    own = np.bincount(parts[head & inside]).argmax() if (head & inside).any() else 0
    matte = ((parts == own) & inside | (hair > _HAIR)).astype(np.float32)
    large = cv2.resize(matte, encoded.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    radius = max(2, round(FEATHER * face_px * encoded.shape[0] / head.shape[0]))
    guide = encoded.astype(np.float32) / 255
    soft = cv2.ximgproc.guidedFilter(guide, large, radius, _EPSILON)
    # a person's new light on what lies behind glows; the old one on a strand of hair hardly shows
    return ((soft - 0.3) / 0.7).clip(0, 1)


def _disc(radius_px: float) -> UInt8[ndarray, "d d"]:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * max(1, round(radius_px)) + 1,) * 2)


def _grown(mask: Bool[ndarray, "p q"], by_px: float) -> Bool[ndarray, "p q"]:
    return cv2.dilate(mask.astype(np.uint8), _disc(by_px)) > 0


def _shrunk(mask: Bool[ndarray, "p q"], by_px: float) -> Bool[ndarray, "p q"]:
    return cv2.erode(mask.astype(np.uint8), _disc(by_px)) > 0


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
