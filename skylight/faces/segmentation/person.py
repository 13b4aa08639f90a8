"""A soft matte of a person: grown from head, hair and bust, refined along the picture's edges."""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray

# Lengths are in heights of the face.
SURE = 0.03  # of the head's border: what lies deeper is the person's for certain
SURE_BUST = 0.15  # of a bust that fits nobody exactly
REACH = 0.35  # about head, hair and bust: what lies farther out is background for certain
FEATHER = 0.015  # radius of the guided filter
_EPSILON = 1e-4  # of the guided filter, for values from 0 to 1
_HAIR, _SURE_HAIR = 0.5, 0.8
_ROUNDS = 4


def person_matte(
    encoded: UInt8[ndarray, "h w 3"],
    head: Bool[ndarray, "p q"],
    bust: Bool[ndarray, "p q"],
    hair: Float32[ndarray, "p q"],
    face_px: float,
) -> Float32[ndarray, "h w"]:
    """How much of each pixel of an sRGB picture is a person, from 0 to 1.

    ``head``, ``bust`` and how likely there is ``hair`` are masks of the same picture at a size at
    which the face is ``face_px`` high. There the person is cut out by GrabCut (Rother et al. 2004),
    which learns the colours of what is sure and decides about the rest; of its result the part
    that holds the head is kept, and its border follows the picture's edges by a guided filter (He
    et al. 2013). Same input, same matte.
    """
    size = head.shape[::-1]
    small = cv2.resize(encoded, size, interpolation=cv2.INTER_AREA)
    labels = np.full(head.shape, cv2.GC_BGD, np.uint8)
    labels[_grown(head | bust | (hair > _HAIR), REACH * face_px)] = cv2.GC_PR_BGD
    labels[_grown(head | (hair > _HAIR), SURE * face_px) | bust] = cv2.GC_PR_FGD
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
        _ROUNDS,
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
