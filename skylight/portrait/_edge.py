"""Light from behind: a bright edge along a person's outline.

What a lamp behind a sitter lights is a band at the outline, narrower than the errors of a fitted
head, and mostly of hair and clothes that no model has. So it is not shaded on the model. The
outline is taken for the edge of something round: at a distance t inside it the surface's normal
leans by ``s = 1 - t / WIDTH`` out of the picture's plane, ``n = (s o, sqrt(1 - s^2))``, o being
the outline's own normal in the picture, and of a lamp in direction d it receives ``e = <n, d>+``.
Along an outline that is cut out right, that is exact for a cylinder of radius :data:`WIDTH`, a
head's; thinner things have narrower edges than these. Of a lamp as bright as the photograph's
light, a place x of luminance Y sends to the camera ::

    e (Y / (Y + v)) (B x + G W c)                                           skin and cloth,
    e / (e + S) (Y / (Y + v)) min(Y / (b + v), 3) (H x + G W c)             hair,

W being the luminance of white in the photograph's light, c the lamp's colour and v the veil of
:mod:`skylight.portrait._room` times white. The first is what has a thing's own colour, the second
what its surface reflects, whatever that is, and at a slant most. Hair is no surface. Its strands
pass on what goes through them, of their own colour, as soon as the light reaches them, and reflect
little: from a lamp behind it black hair is hardly brighter than in even light, and no grey band. b
is the luminance of a strand's surroundings (:func:`surroundings`): the logarithms of path-traced
strands vary three to five times as much in light from behind as in even light, of which these have
two. Where a photograph does not show strands, what they reflect would be a second outline, and
there is as much less of it (:func:`strands_shown`).

B, H and G are those of path-traced people and strands (``python -m tools.measure_rim``) at the
WIDTH and S here, which were chosen. Skin is off by a fifth, root mean square. Hair is made darker
than theirs, by a sixth near the outline, and its band narrower, 0.11 of the face's height for 0.18,
as locks are thinner than a head. Of cloth, B is that of skin below its surface, and G half the
sheen of Burley 2012 ("Physically-based shading at Disney"), which is a choice, as those of how far
an outline is believed are.

An outline is believed as far as the picture tells person and background apart there
(:func:`told_apart`), and where the head model does not contradict it (:func:`known`); the edge's
energy falls with that.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from skylight.portrait._gain import CODES, DARKEST, LUMINANCE_WEIGHTS, blurred, float32, resized

# Lengths are in heights of the face.
GAP = 0.06  # radius of gaps in the matte that are closed
SMOOTH = 0.03  # the standard deviation of the outline's own normal, so that locks have none
WIDTH = 0.3  # jaw and neck fit 0.33, all of a bald head 0.41, hair 0.55
RECUT = 0.04  # by how much an outline may lie too far out
HOLLOW = 0.06  # standard deviation of the surroundings that make a hollow
DEEP = 0.15  # more than a half of them is the person's: an angle of 126 degrees
CHANCE = 0.3  # of what told_apart says: an outline between two halves of one grey has as much
BORDER = 0.02  # of what lies near an outline: radius, and standard deviation of means
ENOUGH = 0.5  # of the same: where it says that or more an edge is drawn wholly
UNSURE = 0.2  # of the same: where it says less the matte is cut back
TOLD = 0.08  # radius of the surroundings in which colours tell person from background
# Of z of the direction to a lamp, towards the camera: from here on it is all edge, and from 0 none
BEHIND = -0.5
METERED = 0.06  # of a ball's brightness: what an edge counts for in an exposure
STRANDS = 0.04  # standard deviation of the surroundings of a strand
MOST_STRAND = 3.0  # times its surroundings: locks reach that, earrings and threads far more
# What lies farther from head and hair, and from a bust, which fits nobody exactly, is no
# outline of theirs
NEAR_HEAD, NEAR_BUST = 0.06, 0.5
BESIDE = 0.05  # standard deviation of what is cut away beside an outline
LIKELY_HAIR = 0.25  # how likely a pixel has to show it
BODY, SKIN_GLOSS = 1.7, 0.9  # B and G
# G of cloth: half of Burley's sheen, pi / 2 (1 - cos a)^5, a being half the angle between the rim
# key and the camera, 67 degrees
CLOTH_GLOSS = 0.13
HAIR_BODY, HAIR_GLOSS, SOON_LIT = 2.5, 0.04, 0.05  # H, G and S
STRAND_CONTRAST = 0.3  # standard deviation of logarithms of path-traced hair in even light


@dataclass(frozen=True, kw_only=True)
class EdgeLight:
    """A lamp behind the sitter: ``direction`` (3,) to it, and how many times as bright as the
    photograph has it it makes what faces it. ``spread_rad`` is the lamp's, and ``colour`` (3,), of
    luminance 1, in the photograph's units."""

    direction: tuple[float, float, float]
    strength: float
    spread_rad: float
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def on(self, leaning: Float[ndarray, "h w 2"]) -> Float[ndarray, "h w"]:
        """``<n, d>+`` of what :func:`leaning` gives, as soft as the lamp is wide.

        Of a lamp whose radius is r, two spreads, the mean of ``x+`` is taken as if it were as
        bright at all heights: ``(x + r)^2 / 4r`` between -r and r, which is more than that of a
        disc by at most 0.04 r, where its middle sets. What faces away from all of it gets none.
        """
        x, y, z = self.direction
        facing = np.sqrt(np.maximum(1 - (leaning**2).sum(2), 0))
        cosine = leaning[..., 0] * x + leaning[..., 1] * y + facing * z
        radius = 2 * self.spread_rad
        risen = np.clip(cosine + radius, 0, 2 * radius)
        return risen**2 / (4 * radius) + np.maximum(cosine - radius, 0)


def lamp_colour(found: tuple[float, float, float]) -> tuple[float, float, float]:
    """Of a lamp in light whose mean colour was ``found``: as warm, at most as blue as white.

    ``(q, 1, 1 / q)``, of luminance 1, with ``q = sqrt(red / blue)``, 1 at least. A colour that is
    found in a photograph is off by a tenth or so, and on dark hair what is bluer than white, or
    has less green, is seen as lavender.
    """
    red, _, blue = (max(each, 1e-6) for each in found)
    warm = max(math.sqrt(red / blue), 1.0)
    colour = np.array([warm, 1.0, 1 / warm])
    red, green, blue = (colour / (colour @ LUMINANCE_WEIGHTS)).tolist()
    return red, green, blue


def edge_share(z: float) -> float:
    """How much of a lamp in a direction of that z is drawn as an edge, and not on the model."""
    return min(max(z / BEHIND, 0.0), 1.0)


@dataclass(frozen=True, kw_only=True)
class Outline:
    """What of a person a lamp behind it lights, in the module's words.

    ``leaning`` (p,q,2) is ``s o``, ``around`` (p,q) b, and ``sure`` (h,w) how far
    :func:`told_apart` has reached :data:`ENOUGH`. ``surface`` and ``hair`` (p,q) are how much of a
    place is of these and lit, as far as the outline is :func:`known`; ``gloss`` (p,q) is G.
    """

    leaning: Float[ndarray, "p q 2"]
    around: Float[ndarray, "p q"]
    sure: Float[ndarray, "h w"]
    surface: Float[ndarray, "p q"]
    hair: Float[ndarray, "p q"]
    gloss: Float[ndarray, "p q"]

    @staticmethod
    def of(
        picture: Float[ndarray, "p q 3"],
        matte: Float[ndarray, "p q"],
        own: Float[ndarray, "p q"],
        sure: Float[ndarray, "h w"],
        known: Float[ndarray, "p q"],
        skin: Float[ndarray, "p q"],
        hair: Float[ndarray, "p q"],
        face_px: float,
    ) -> "Outline":
        """Of a picture at the size of shading, its ``matte``, and how much of its light is the
        person's ``own``; ``skin`` is how far a place has its colour, ``hair`` how likely it is."""
        small = cv2.resize(sure, matte.shape[::-1], interpolation=cv2.INTER_AREA)
        edge_of = recut(matte, small, face_px)
        hair = np.clip(2 * hair - 1, 0, 1)
        outer = _wider(hair, BORDER * face_px) * (1 - _wider(skin, BORDER * face_px))
        hair = np.maximum(hair, outer)
        level, behind = uncovered(edge_of, small, hair, face_px)
        lit = known * level
        # a pixel that is likely enough a person's; how sure the outline is counts in level
        sure = np.minimum(sure / ENOUGH, 1)
        return Outline(
            leaning=leaning(edge_of, face_px),
            around=surroundings(picture, own, face_px),
            sure=sure,
            surface=float32(lit * (1 - hair) * (1 - behind)),
            hair=float32(lit * hair),
            gloss=float32(
                (1 - hair) * (CLOTH_GLOSS + skin * (SKIN_GLOSS - CLOTH_GLOSS))
                + hair * HAIR_GLOSS * strands_shown(picture, own, face_px)
            ),
        )

    def lit(self, light: EdgeLight) -> Float[ndarray, "h w 2"]:
        """The edge of surfaces and of hair, as far as the outline is believed: what is received,
        times the lamp's strength."""
        size = (self.sure.shape[0], self.sure.shape[1])
        received = light.on(resized(self.leaning, size))
        surface, hair = (resized(x, size) for x in (self.surface, self.hair))
        both = np.dstack([surface * received, hair * received / (received + np.float32(SOON_LIT))])
        return np.float32(light.strength) * self.sure[..., None] * both

    def sent(
        self,
        picture: Float[ndarray, "h w 3"],
        edge: Float[ndarray, "h w 2"],
        colour: Float[ndarray, "3"],
        white: float,
        veil: float,
    ) -> Float[ndarray, "h w 3"]:
        """What an ``edge`` adds: ``colour`` is c, ``white`` W, ``veil`` v, above 0."""
        size = (picture.shape[0], picture.shape[1])
        around, gloss = (resized(x, size) for x in (self.around, self.gloss))
        shown = np.maximum(picture @ LUMINANCE_WEIGHTS, 0)
        surface, hair = np.moveaxis(edge * (shown / (shown + np.float32(veil)))[..., None], 2, 0)
        strand = np.minimum(shown / (around + np.float32(veil)), MOST_STRAND)
        body = surface * np.float32(BODY) + hair * np.float32(HAIR_BODY) * strand
        bright = (surface + hair * strand) * gloss * np.float32(white)
        return body[..., None] * picture + bright[..., None] * colour


def _wider(mask: Float[ndarray, "p q"], by_px: float) -> Float[ndarray, "p q"]:
    """The largest value within a disc."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * max(1, round(by_px)) + 1,) * 2)
    return cv2.dilate(float32(mask), disc)


def strands_shown(
    picture: Float[ndarray, "p q 3"], own: Float[ndarray, "p q"], face_px: float
) -> Float[ndarray, "p q"]:
    """How far strands show: the variance of logarithms within :data:`BORDER` over that of
    path-traced hair, at most 1."""
    level = np.log(np.maximum(picture @ LUMINANCE_WEIGHTS, 0) + np.float32(DARKEST))[..., None]
    near, square = (blurred(x, own**4, BORDER * face_px)[..., 0] for x in (level, level**2))
    return np.clip((square - near**2) / STRAND_CONTRAST**2, 0, 1)


def surroundings(
    picture: Float[ndarray, "h w 3"], matte: Float[ndarray, "h w"], face_px: float
) -> Float[ndarray, "h w"]:
    """Mean luminance of what of the person lies within :data:`STRANDS`."""
    shown = np.maximum(picture @ LUMINANCE_WEIGHTS, 0)[..., None]
    return blurred(shown, matte**4, STRANDS * face_px)[..., 0]


def recut(
    matte: Float[ndarray, "p q"], sure: Float[ndarray, "p q"], face_px: float
) -> Float[ndarray, "p q"]:
    """A matte whose outline lies where colours have it, by :data:`RECUT` farther in at most.

    What was cut out too large is no person's, and the edge begins where the person does.
    """
    side = 2 * round(RECUT * face_px) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    inside = cv2.erode(float32(matte), disc)
    return np.maximum(inside, matte * np.minimum(sure / UNSURE, 1))


def told_apart(
    picture: Float[ndarray, "h w 3"], matte: Float[ndarray, "h w"], face_px: float
) -> Float[ndarray, "h w"]:
    """How much likelier a place shows the person than what is behind, by its colour: 0 to 1.

    ``2 q - 1`` where that is above 0, q being the line from the picture's colours to the matte
    that fits best near the place (a guided filter, He et al. 2013). It is 1 where colours tell the
    two apart, and 0 along an outline on either side of which the picture is the same, in whose
    middle a cut is chance.
    """
    # in codes, as soft_matte has it
    guide = float32(255 * np.sqrt(np.clip(picture, 0, 1)))
    radius = max(2, round(TOLD * face_px))
    likely = cv2.ximgproc.guidedFilter(guide, float32(matte), radius, CODES**2)
    return np.clip(2 * likely - 1, 0, 1)


def known(
    head: Bool[ndarray, "p q"],
    hair: Float[ndarray, "p q"],
    bust: Bool[ndarray, "p q"],
    matte: Float[ndarray, "p q"],
    face_px: float,
) -> Float[ndarray, "p q"]:
    """How far the outline of the ``matte`` is to be believed.

    1 near head, likely ``hair`` and bust, softly to 0. What is cut away beside it is taken for
    the person by the model in part: by as much less, for between a jumper and an open coat, or a
    neck and a hand, there is no outline.
    """

    def near(mask: Bool[ndarray, "p q"], reach: float) -> Float[ndarray, "p q"]:
        away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
        return np.clip(1 + (reach * face_px - away) / (SMOOTH * face_px), 0, 1)

    close = np.maximum(near(head | (hair > LIKELY_HAIR), NEAR_HEAD), near(bust, NEAR_BUST))
    model = float32(head | bust)[..., None]
    missing = blurred(model, float32(1 - matte), BESIDE * face_px)[..., 0]
    return close * (1 - missing)


def uncovered(
    matte: Float[ndarray, "p q"],
    sure: Float[ndarray, "p q"],
    hair: Float[ndarray, "p q"],
    face_px: float,
) -> tuple[Float[ndarray, "p q"], Float[ndarray, "p q"]]:
    """How much of a lamp the nearest outline sees, and how far it is of ``hair``: 0 to 1.

    None where it is no more ``sure`` (:func:`told_apart`) along it than a cut by chance is. In a
    hollow, as between neck and shoulder, an outline faces itself and not the lamp: of one of
    126 degrees or less there is none, of a straight or a bulging outline all. Hair at the outline
    lies between the lamp and the skin farther in.
    """
    small = _whole(matte, face_px)
    inside = (small > 0.5).astype(np.uint8)
    _, nearest = cv2.distanceTransformWithLabels(
        inside, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero(inside == 0)
    if not len(rows):
        return np.ones_like(small), np.zeros_like(small)
    at = nearest - 1  # what is outside is counted from 1, row by row
    share = cv2.GaussianBlur(small, (0, 0), HOLLOW * face_px)
    level = np.clip(1 - (share[rows, columns] - 0.5) / DEEP, 0, 1)
    along = blurred(sure[..., None], float32(inside), BORDER * face_px)[rows, columns, 0]
    level = (level * np.clip((along - CHANCE) / (1 - 2 * CHANCE), 0, 1))[at]
    behind = hair[rows, columns][at]
    lit, hairy = (cv2.GaussianBlur(float32(x), (0, 0), SMOOTH * face_px) for x in (level, behind))
    return lit, hairy


def leaning(matte: Float[ndarray, "p q"], face_px: float) -> Float[ndarray, "p q 2"]:
    """``s o`` of the module's text, to the right and up.

    0 farther inside than :data:`WIDTH`, and at the picture's border, which is no outline.
    """
    wide = round(WIDTH * face_px) + 2

    small = cv2.copyMakeBorder(float32(matte), wide, wide, wide, wide, cv2.BORDER_REPLICATE)
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
