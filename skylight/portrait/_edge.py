"""Light from behind: a bright edge along a person's outline.

What a lamp behind a sitter lights is a band at the outline, narrower than the errors of a fitted
head, and mostly of hair and clothes that no model has. So it is not shaded on the model. The
outline is taken for the edge of something round: at a distance t inside it the surface's normal
leans by ``s = 1 - t / WIDTH`` out of the picture's plane, ``n = (s o, sqrt(1 - s^2))``, o being
the outline's own normal in the picture, and a lamp in direction d sends it ``<n, d>+``, of which
:data:`GRAZING` times as much as of light from the front is reflected. Along an
outline that is cut out right, that is exact for a cylinder whose radius is :data:`WIDTH`; thicker
things have wider edges than these. Where neither head, hair nor bust is near, the outline is not
known, and gets no edge.

A place x of luminance Y sends back, times the edge, what it shows and a sheen ::

    x + SHEEN M min(Y / (b + v), 3) Y / (Y + v),

b being the luminance of its surroundings (:func:`surroundings`), M that of skin, and v the veil of
:mod:`skylight.portrait._room` times white. The first is what has a thing's own colour, the second
what its surface reflects, in the mean as much of dark things as of pale ones and in the lamp's
colour, white here, as the first highlight of hair is (Marschner et al. 2003). It is a multiple of
what is there, so strands keep their contrast; what is even and as dark as stray light has a quarter
of it, and what is far brighter than its surroundings, as an earring in black hair, three times
as much. How strands run is not known: their highlights are as broad as cloth's.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from skylight.portrait._gain import LUMINANCE_WEIGHTS, blurred, float32

WIDTH = 0.16  # of the face's height; with 0.36, a sheen of 1 and less light judges saw grey fog
GAP = 0.06  # of it: radius of gaps in the matte that are closed
SMOOTH = 0.03  # of it: the standard deviation of the outline's own normal, so that locks have none
# Of z of the direction to a lamp, towards the camera: from here on it is all edge, and from 0 none
BEHIND = -0.5
METERED = 0.06  # of a ball's brightness: what an edge counts for in an exposure
GRAZING = 5.0  # times as much is reflected from behind as Lambert's law has it: Fresnel's
SHEEN = 0.6  # of what skin sends back
STRANDS = 0.04  # of a face's height: standard deviation of the surroundings of a strand
MOST_STRAND = 3.0  # times its surroundings: locks reach that, earrings and threads far more
# Of it: what lies farther from head and hair, and from a bust, which fits nobody exactly, is no
# outline of theirs
NEAR_HEAD, NEAR_BUST = 0.06, 0.5
LIKELY_HAIR = 0.25  # how likely a pixel has to show it


@dataclass(frozen=True, kw_only=True)
class EdgeLight:
    """A lamp behind the sitter: ``direction`` (3,) to it, and how many times as bright as the
    photograph has it it makes what faces it. ``spread_rad`` is the lamp's."""

    direction: tuple[float, float, float]
    strength: float
    spread_rad: float

    def on(self, leaning: Float[ndarray, "h w 2"]) -> Float[ndarray, "h w"]:
        """``GRAZING strength <n, d>+`` of what :func:`leaning` gives, as soft as the lamp is wide.

        Of a lamp whose radius is r, two spreads, the mean of ``x+`` is taken as if it were as
        bright at all heights: ``(x + r)^2 / 4r`` between -r and r, which is more than that of a
        disc by at most 0.04 r, where its middle sets. What faces away from all of it gets none.
        """
        x, y, z = self.direction
        facing = np.sqrt(np.maximum(1 - (leaning**2).sum(2), 0))
        cosine = leaning[..., 0] * x + leaning[..., 1] * y + facing * z
        radius = 2 * self.spread_rad
        risen = np.clip(cosine + radius, 0, 2 * radius)
        received = risen**2 / (4 * radius) + np.maximum(cosine - radius, 0)
        return GRAZING * self.strength * received


def edge_share(z: float) -> float:
    """How much of a lamp in a direction of that z is drawn as an edge, and not on the model."""
    return min(max(z / BEHIND, 0.0), 1.0)


def reflected(
    picture: Float[ndarray, "h w 3"],
    around: Float[ndarray, "h w"],
    bright: float,
    veil: float,
) -> Float[ndarray, "h w 3"]:
    """What an edge multiplies, by the module's text: b is ``around``, M ``bright``, v ``veil``, of
    which the last is above 0 where something is black."""
    shown = np.maximum(picture @ LUMINANCE_WEIGHTS, 0)
    strand = np.minimum(shown / (around + veil), MOST_STRAND)
    sheen = np.float32(SHEEN * bright) * strand * shown / (shown + veil)
    return picture + sheen[..., None]


def surroundings(
    picture: Float[ndarray, "h w 3"], matte: Float[ndarray, "h w"], face_px: float
) -> Float[ndarray, "h w"]:
    """Mean luminance of what of the person lies within :data:`STRANDS`."""
    shown = np.maximum(picture @ LUMINANCE_WEIGHTS, 0)[..., None]
    return blurred(shown, matte**4, STRANDS * face_px)[..., 0]


def known(
    head: Bool[ndarray, "p q"],
    hair: Float[ndarray, "p q"],
    bust: Bool[ndarray, "p q"],
    face_px: float,
) -> Float[ndarray, "p q"]:
    """How far the outline is to be believed: 1 near head, likely ``hair`` and bust, softly to 0."""

    def near(mask: Bool[ndarray, "p q"], reach: float) -> Float[ndarray, "p q"]:
        away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
        return np.clip(1 + (reach * face_px - away) / (SMOOTH * face_px), 0, 1)

    return np.maximum(near(head | (hair > LIKELY_HAIR), NEAR_HEAD), near(bust, NEAR_BUST))


def leaning(
    matte: Float[ndarray, "h w"], size: tuple[int, int], face_px: float
) -> Float[ndarray, "p q 2"]:
    """``s o`` of the module's text, to the right and up, at a (height, width).

    ``face_px`` is of that size. 0 farther inside than :data:`WIDTH`, and at the picture's border,
    which is no outline.
    """
    small = cv2.resize(float32(matte), size[::-1], interpolation=cv2.INTER_AREA)
    wide = round(WIDTH * face_px) + 2
    small = cv2.copyMakeBorder(small, wide, wide, wide, wide, cv2.BORDER_REPLICATE)
    small = _whole(small, face_px)
    within = cv2.distanceTransform((small > 0.5).astype(np.uint8), cv2.DIST_L2, 5)
    smooth = cv2.GaussianBlur(small, (0, 0), SMOOTH * face_px)
    # of the distance too, whose gradient reaches farther in than the matte's
    height = np.minimum(within / (WIDTH * face_px), 1) + smooth
    height = cv2.GaussianBlur(height, (0, 0), SMOOTH * face_px)
    down, right = np.gradient(height)
    length = np.sqrt(down**2 + right**2)
    share = 1 - np.minimum(within / (WIDTH * face_px), 1)
    out = np.dstack([-right, down]) * (share / np.maximum(length, 1e-6))[..., None]
    return float32(out[wide:-wide, wide:-wide])


def _whole(matte: Float[ndarray, "h w"], face_px: float) -> Float[ndarray, "h w"]:
    """Without gaps between locks and holes at earrings, which are no outline."""
    side = 2 * round(GAP * face_px) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    return cv2.morphologyEx(matte, cv2.MORPH_CLOSE, disc)
