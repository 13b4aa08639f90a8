"""What room a photograph has for a new light: below white, above its veil, within the person.

A camera's codes end at white, where colour is lost first; its blacks are the lens's stray light and
no dark thing's; and a pixel on a person's border is in part what lies behind. A gain that knows of
none of these makes white cloth flat, dark hair grey, and a glow about the head. All is judged by
the :func:`base_of` the picture, its edges without its texture (Durand and Dorsey 2002), so that
texture keeps its contrast.
"""

import math

import cv2
import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from skylight.imaging._colour import srgb_to_linear
from skylight.imaging._photo import Photo
from skylight.portrait._gain import (
    BRIGHTER,
    DARKER,
    DARKEST,
    EDGE,
    EDGE_OF_WHITE,
    LUMINANCE_WEIGHTS,
    PORES,
    blurred,
    float32,
)

VEILING = 0.02  # stray light over the picture's mean: glare of usual lenses is 1 to 3 % (ISO 9358)
LEAST_ROOM = 0.05  # logarithm: room at SHORT + LEAST_ROOM below white
ROUND = 0.05  # logarithm: over which room ends
SHORT = 0.15  # logarithm: where skin near white has neither colour nor shape
# Where room would end were it not round, so that it is LEAST_ROOM there
BEGINS = SHORT + LEAST_ROOM - ROUND * math.log(math.expm1(LEAST_ROOM / ROUND))
OVER = 1.0  # logarithm: how much brighter than white a white place may have been
OTHER_BRIGHTER, OTHER_DARKER = 0.35, 0.7  # logarithms: half a stop and one, of hair and clothes
_MIDDLE = 20, 230  # codes that are neither dark nor clipped
_ROWS = 4
_ROUNDED = 0.05  # what codes and gammas may differ by
# of a face's height, how far a person's colour is looked for; and its matte
WITHIN, WHOLLY = 0.03, 0.95


def white_of(photo: Photo) -> float:
    """The linear value that ``photo.encoded`` shows as white, by the middle codes of some rows."""
    encoded, pixels = photo.encoded[::_ROWS], photo.pixels[::_ROWS]
    middle = ((encoded > _MIDDLE[0]) & (encoded < _MIDDLE[1])).all(2)
    if not middle.any():
        return 1.0
    codes = torch.from_numpy(encoded[middle]).float() / 255
    ratio = float(pixels[torch.from_numpy(middle)].sum() / srgb_to_linear(codes).sum())
    return 1.0 if abs(ratio - 1) < _ROUNDED else ratio


def base_of(
    picture: Float[ndarray, "h w 3"], white: float, face_px: float
) -> Float[ndarray, "h w"]:
    """``ln(max(r, g, b) / white + DARKEST)`` of a linear picture, at most 0, by a guided filter."""
    seen = float32(np.log(np.maximum(picture.max(2) / white, 0) + DARKEST))
    radius = max(2, round(EDGE * face_px))
    return np.minimum(cv2.ximgproc.guidedFilter(seen, seen, radius, PORES**2), 0)


def veil_of(picture: Float[ndarray, "h w 3"], white: float) -> float:
    """Stray light over white, :data:`VEILING` of the picture's mean."""
    return VEILING * float((np.clip(picture / white, 0, 1) @ LUMINANCE_WEIGHTS).mean())


def headroom(
    base: Float[ndarray, "h w"], typical: float, skin: Float[ndarray, "h w"]
) -> tuple[Float[ndarray, "h w"], Float[ndarray, "h w"]]:
    """How much brighter and darker than with a ``typical`` gain a place may become, logarithms.

    Brighter to :data:`SHORT` of white, and by :data:`~skylight.portrait._gain.BRIGHTER`, in all
    where the typical gain is below 0. What is no ``skin``, whose shape is not known, by less both
    ways. Of a gain that is bounded by m it is ::

        (m^-4 + s^-4)^(-1/4),    s = ROUND ln(1 + e^((-base - typical - BEGINS) / ROUND)),

    which bends at no brightness, and is nowhere more than the lesser of m and the larger of
    ``-base - typical - SHORT`` and :data:`LEAST_ROOM`.
    """
    most = skin * (BRIGHTER - min(typical, 0.0)) + (1 - skin) * np.float32(OTHER_BRIGHTER)
    least = skin * np.float32(DARKER) + (1 - skin) * np.float32(OTHER_DARKER)
    room = (-base - np.float32(typical + BEGINS)) / np.float32(ROUND)
    room = np.float32(ROUND) * np.logaddexp(np.float32(0), room)
    return most * room / (most**4 + room**4) ** np.float32(0.25), least


def below_white(
    gain: Float[ndarray, "h w"], base: Float[ndarray, "h w"], skin: Float[ndarray, "h w"]
) -> Float[ndarray, "h w"]:
    """A gain that makes what was white darker by :data:`OVER` less, for it was brighter than that:
    a darker white is a grey patch. ``skin``, whose shape is known, is made darker all the same.
    """
    lost = (1 - skin) * np.clip(1 - (1 - np.exp(base)) / EDGE_OF_WHITE, 0, 1)
    return np.maximum(gain, 0) + np.minimum(np.minimum(gain, 0) + np.float32(OVER) * lost, 0)


def above_veil(
    gain: Float[ndarray, "h w"],
    base: Float[ndarray, "h w"],
    skin: Float[ndarray, "h w"],
    veil: float,
    typical: float,
) -> Float[ndarray, "h w"]:
    """A logarithmic gain of which only what is brighter than the veil becomes brighter.

    ``ln(t + (e^G - t) (1 - veil / b))`` where G is above ``ln t``, t being ``e^typical`` and 1 at
    least: black hair stays as black as skin in the mean lets it. Black ``skin`` is in shadow, out
    of which it comes.
    """
    usual = max(typical, 0.0)
    lit = 1 - (1 - skin) * np.minimum(np.float32(veil) * np.exp(-base), 1)
    rise = np.log1p(np.expm1(np.maximum(gain - usual, 0)) * lit)
    return np.minimum(gain, usual) + rise


def light_share(
    picture: Float[ndarray, "h w 3"], matte: Float[ndarray, "h w"], face_px: float
) -> Float[ndarray, "h w"]:
    """How much of a pixel's light is the person's, of how much of its area is: ``a min(1, F / x)``.

    F is the person's luminance a little further in: of a dark strand before a bright sky almost
    all light is the sky's, and stays.
    """
    inside = float32(matte > WHOLLY)
    shown = (picture @ LUMINANCE_WEIGHTS)[..., None]
    own = blurred(shown, inside, WITHIN * face_px)
    dim = np.minimum(1, own / np.maximum(shown, 1e-6))[..., 0]
    sure = np.clip((matte - WHOLLY) / (1 - WHOLLY), 0, 1)
    return matte * (sure + (1 - sure) * dim)
