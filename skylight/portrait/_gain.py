"""How a new light changes a picture: smooth, bounded gains that the picture's own edges place.

A fitted head is off by some hundredths of its height and the light found by some degrees, so a
ratio of shadings that is sharper than that is wrong beside every edge. Here a light's
level (:func:`level_of`) is the expectation of its shading over such errors, as a normalised
convolution over the face; gains are differences of two lights' levels. Ears, neck, hair and clothes
are where the model fits least: they get the face's gain, continued smoothly
(:meth:`Surface.beyond`), so that no part of a person is relit without the rest.

Of the old light only what the picture shows is taken away (:func:`unseen`): shadows are removed
where the picture has them, and those that it lacks are not inverted.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, Shaped
from numpy import ndarray

from skylight.sphere._envmap import LUMINANCE

# Lengths are in heights of the face.
SHARP = 0.02  # standard deviation of the Gaussian of shading: what a fitted head is off by
REACH = 0.12  # and of what is taken of a face's gain beyond it
EXACT = 0.01  # and of the shading whose edges the picture places
LOCAL = 0.05  # and of the neighbourhood in which shading is compared with the picture
EDGE = 0.02  # radius of the guided filter that tells shading's edges from texture
SPREAD = 0.1  # and of the one of the matte in clothes
CODES = 8.0  # of 255: less is no edge of a person
NEAR = 0.05  # of a Gaussian of REACH: skin that is near enough
# Logarithms.
BRIGHTER, DARKER = 1.0, 2.0  # what gains of skin approach on either side of its mean
KNEE = 0.35  # half a stop: over which a gain bends at least, for a sharper bend shows as a seam
TEXTURE = 0.05  # standard deviation of skin's albedo
HUE = 0.35  # what skin's own colour differs by between shadow and light
ALIKE = 0.25  # and from place to place
SOON = 0.25  # change of level
LIPS, STRAYED = 0.35, 0.6  # how alike lips are to skin at most, and skin near white at least
GLOSSY = 0.3  # brighter than usual skin: a highlight
STEPS = 16  # of brightness
_NO_ROOM = np.float32(1e-4)
FEW = 0.004  # of a face's pixels: so many tell little of their colour
PORES = 0.15  # what the guided filter takes for texture
BASE = 0.01  # of the mean shading, in addition: light that scatters below the skin
# Of white, below it: where codes lose brightness; a smaller range shows as an edge
EDGE_OF_WHITE = 0.25
SHINE = 0.7  # of the specular reflection, which no estimate knows well
DARKEST = 0.004  # of white, before logarithms: noise of the darkest pixels
LUMINANCE_WEIGHTS = np.array(LUMINANCE, np.float32)


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
    """
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


def resized(picture: Float[ndarray, "p q *c"], size: tuple[int, int]) -> Float[ndarray, "h w *c"]:
    """At (height, width), by linear interpolation."""
    return cv2.resize(float32(picture), size[::-1], interpolation=cv2.INTER_LINEAR)


def enlarged(
    picture: Float[ndarray, "p q c"], known: Float[ndarray, "p q"], size: tuple[int, int]
) -> Float[ndarray, "h w c"]:
    """The same of a :func:`filled` picture."""
    return resized(filled(picture, known), size).reshape(*size, -1)


@dataclass(frozen=True, kw_only=True)
class Surface:
    """Where a picture of shading shows skin (``bare``), that of the face (``face``), and what light
    was traced to: skin below hair too (``traced``)."""

    bare: Float[ndarray, "p q"]
    face: Float[ndarray, "p q"]
    traced: Float[ndarray, "p q"]
    face_px: float

    def mean(self, picture: Float[ndarray, "p q c"]) -> Float[ndarray, " c"]:
        """Over the skin."""
        return picture[self.bare > 0].mean(0)

    def share(self) -> Float[ndarray, "p q"]:
        """How much of a place is the face's, with a soft border."""
        return cv2.GaussianBlur(self.face, (0, 0), EXACT * self.face_px)

    def beyond(self, gain: Float[ndarray, "p q"]) -> Float[ndarray, "p q"]:
        """What is known of the face, continued over ears, neck, hair and clothes.

        Its mean over :data:`REACH`, and :func:`filled` where no skin is so near.
        """
        reach = REACH * self.face_px
        near = blurred(gain[..., None], self.face, reach)
        cover = cv2.GaussianBlur(self.face, (0, 0), reach)
        return filled(near, np.clip(cover / NEAR, 0, 1))[..., 0]

    def share_of(
        self, part: Float[ndarray, "p q"], shading: Float[ndarray, "p q 3"]
    ) -> Float[ndarray, "p q"]:
        """``part / (part + shading)`` near the face, by luminances as smooth as levels are."""
        both = np.dstack([part, part + shading @ LUMINANCE_WEIGHTS])
        near = blurred(both, self.face, SHARP * self.face_px)
        return near[..., 0] / np.maximum(near[..., 1], 1e-9)

    def continued(self, gain: Float[ndarray, "p q"]) -> Float[ndarray, "p q"]:
        """The face's own, and :meth:`beyond` it."""
        share = self.share()
        return share * gain + (1 - share) * self.beyond(gain)


def level_of(
    shading: Float[ndarray, "p q 3"],
    hollow: Float[ndarray, "p q"],
    specular: Float[ndarray, "p q 3"],
    on: Surface,
    sharp: float = SHARP,
) -> Float[ndarray, "p q"]:
    """Light on a face as far as it is known, ``ln(E[S + B + SHINE g] + BASE mean(S))``.

    Of the luminance of diffuse and, in part, specular reflection of albedo 1; ``specular`` is over
    the albedo, and ``hollow`` is B of :mod:`skylight.portrait._bounce`.
    The expectation is over the face near a place, and of no use far from it.
    """
    whole = ((shading + SHINE * specular) @ LUMINANCE_WEIGHTS + hollow)[..., None]
    base = BASE * float(on.mean(shading) @ LUMINANCE_WEIGHTS)
    near = blurred(whole, on.face, sharp * on.face_px)[..., 0]
    return np.log(np.maximum(near + base, 1e-9))


def colour_of(light: Float[ndarray, "*n 3"]) -> Float[ndarray, "*n 3"]:
    """Logarithms of channels over luminance."""
    light = np.maximum(light, 0) + np.float32(1e-6)
    return np.log(light / (light @ LUMINANCE_WEIGHTS)[..., None])


def bounded(
    gain: Float[ndarray, "*s"],
    brighter: float | Float[ndarray, "*s"] = BRIGHTER,
    darker: float | Float[ndarray, "*s"] = DARKER,
) -> Float[ndarray, "*s"]:
    """A logarithm x with a soft knee: it approaches b = ``brighter`` and -d = ``-darker``.

    ``b tanh(r x / b)`` above 0 and ``-d tanh(y / d)`` below, with ``r = (1 + (k / b)^4)^(-1/8)``,
    ``y = |x| - (1 - r) k (1 - e^(x / k))`` and k :data:`KNEE`. Where b is above k, r is nearly 1.
    Where it is less, as near white, r is sqrt(b / k), and the slope falls to that before x is 0: it
    is continuous, and changes by no more than 1 in k, however little room there is. A step of light
    across a highlight would show as a seam where it changes its sign, were the slope 1 there.

    Shadows brightened further show noise, which ``e`` times the light makes 1.5 times as large in a
    picture's codes, ``e^(1 / 2.4)``; skin darkened further loses its texture.
    """
    most = np.maximum(np.float32(brighter), _NO_ROOM)
    slope = (1 + (np.float32(KNEE) / most) ** 4) ** np.float32(-0.125)
    more, less = np.maximum(gain, 0), np.minimum(gain, 0)
    less = less - (1 - slope) * np.float32(KNEE) * np.expm1(less / np.float32(KNEE))
    least = np.float32(darker)
    return most * np.tanh(slope * more / most) + least * np.tanh(less / least)


@dataclass(frozen=True, kw_only=True)
class SkinColour:
    """What skin of each brightness lacks to the colour of skin of usual brightness.

    Shadows are greyer in photographs, and light near white; so skin that a new light makes darker
    or brighter changes its colour too. ``lacks`` (n,3) are logarithms at ``n`` steps of
    :func:`~skylight.portrait._room.base_of`, from ``ln DARKEST`` to 0, of means over the face, so
    they are the same wherever skin is as bright. ``alike`` (p,q) is how far a place has the colour
    of skin of its brightness, as a collar, lips and hair have not. ``pale`` (p,q,3) is
    what each channel of a highlight has to lose to get the colour of usual skin, a logarithm of at
    most 0, and of one channel 0. ``astray`` (p,q) is how far skin near white has left the line from
    usual skin to white along ``across`` (3,), a unit vector that, near white, hardly changes
    luminance or the distance to white: red ends at white before the others do, so over-exposed skin
    is yellow or green, which is not seen until it is made darker.
    """

    lacks: Float[ndarray, "n 3"]
    alike: Float[ndarray, "p q"]
    pale: Float[ndarray, "p q 3"]
    astray: Float[ndarray, "p q"]
    across: Float[ndarray, "3"]

    @staticmethod
    def of(
        picture: Float[ndarray, "p q 3"],
        base: Float[ndarray, "p q"],
        plain: Float[ndarray, "p q"],
        on: Surface,
        lacks: Float[ndarray, "n 3"] | None = None,
    ) -> "SkinColour":
        """Of a linear picture at the size of shading, and where albedo is ``plain``.

        What skin ``lacks`` is found where it is not given."""
        steps = np.linspace(math.log(DARKEST), 0, STEPS, dtype=np.float32)
        width = steps[1] - steps[0]
        shown = colour_of(blurred(picture, plain, EXACT * on.face_px))
        skin = plain > 0
        usual = np.median(base[skin])
        mean = np.average(shown[skin], 0, np.exp(-(((base[skin] - usual) / width) ** 2) / 2))
        table = lacks
        if table is None:
            near = np.exp(-(((base[skin] - steps[:, None]) / width) ** 2) / 2)
            table = near @ (mean - shown[skin]) / (near.sum(1) + FEW * skin.sum())[:, None]
            table = HUE * np.tanh(table / HUE)
        own = colour_of(blurred(picture, on.bare, EXACT * on.face_px))
        off = own - (mean - _at(base, table))
        alike = on.bare * np.exp(-(off**2).sum(2) / (2 * ALIKE**2))
        soft = EXACT * on.face_px
        # what is brighter than usual skin and paler lies on the line to white
        bright = np.clip((base - usual) / GLOSSY, 0, 1)
        paler = np.clip((mean - own) @ mean / max(mean @ mean, 1e-6), 0, 1)[..., None] * mean
        off = np.square(mean - own - paler).sum(2)
        share = plain * bright * np.exp(-off / (2 * ALIKE**2))
        towards = paler - alike[..., None] * _at(base, table)
        # less of all channels but the one that is to have most: to cut off what would be more of
        # red leaves it yellow, and darkened yellow is green
        pale = share[..., None] * (towards - towards.max(2, keepdims=True))
        across = np.cross(mean, LUMINANCE_WEIGHTS)
        across = across / max(float(np.linalg.norm(across)), 1e-6)
        # lips and what else has not the colour of skin of its brightness is no skin astray
        skin_like = np.clip((alike - LIPS) / (STRAYED - LIPS), 0, 1)
        near_white = skin_like * np.clip(1 - (1 - np.exp(base)) / EDGE_OF_WHITE, 0, 1)
        astray = near_white * HUE * np.tanh(own @ across / HUE)
        return SkinColour(
            lacks=float32(table),
            alike=cv2.GaussianBlur(float32(alike), (0, 0), soft),
            pale=cv2.GaussianBlur(float32(pale), (0, 0), soft),
            astray=cv2.GaussianBlur(float32(astray), (0, 0), soft),
            across=float32(across),
        )

    def out_of_white(self, level: Float[ndarray, "h w"]) -> Float[ndarray, "h w 3"]:
        """Of colour where a ``level`` below 0 brings skin back from white: its hue is skin's.

        The level is of all that makes the picture darker, an exposure too."""
        share = _soon(np.minimum(level, 0))
        size = (level.shape[0], level.shape[1])
        return -(share * resized(self.astray, size))[..., None] * self.across

    def without_highlights(self, gain: Float[ndarray, "h w"]) -> Float[ndarray, "h w 3"]:
        """Of colour where ``gain`` is below 0: a highlight of the old light goes with it.

        What lies between usual skin and white gets the colour of usual skin, and no channel
        becomes more: so the highlight's brightness goes too.
        """
        share = _soon(np.minimum(gain, 0))
        return share[..., None] * resized(self.pale, (gain.shape[0], gain.shape[1]))

    def change(
        self, gain: Float[ndarray, "h w"], base: Float[ndarray, "h w"]
    ) -> Float[ndarray, "h w 3"]:
        """Of colour with a ``gain`` of level: most of what skin of a place's brightness lacks, once
        that changes by :data:`SOON`.
        """
        share = resized(self.alike, (gain.shape[0], gain.shape[1])) * _soon(gain)
        return share[..., None] * _at(base, self.lacks)


def _soon(change: Float[ndarray, "h w"]) -> Float[ndarray, "h w"]:
    """How much of a colour comes with a change x of level: ``1 - (1 + y) e^-y``, y = 2 |x| / SOON.

    It begins without a slope, which would be seen as a line where x is 0.
    """
    away = np.abs(change) * np.float32(2 / SOON)
    return 1 - (1 + away) * np.exp(-away)


def _at(base: Float[ndarray, "h w"], table: Float[ndarray, "n 3"]) -> Float[ndarray, "h w 3"]:
    steps = np.linspace(math.log(DARKEST), 0, len(table))
    return np.dstack([float32(np.interp(base, steps, column)) for column in table.T])


@dataclass(frozen=True, kw_only=True)
class Unseen:
    """What of the old light's variation the picture does not show, so that it is not taken away.

    ``level`` (h,w) is at the picture's pixels. ``slope`` is how
    much of the light's variation over skin the picture shows in all, from 0 to 1, and ``contrast``
    the standard deviation of the picture's logarithm there.
    """

    level: Float[ndarray, "h w"]
    slope: float
    contrast: float


def unseen(
    picture: Float[ndarray, "h w 3"],
    before: Float[ndarray, "p q"],
    exact: Float[ndarray, "p q"],
    plain: Float[ndarray, "p q"],
    on: Surface,
    slope: float | None = None,
) -> Unseen:
    """Of a linear picture, the old light, the same with its edges, and where albedo is ``plain``.

    The picture's ``slope`` over the light's, found where it is not given, is bounded to 0..1 for
    all of the skin, then a guided
    filter (He et al. 2013), whose lines ``a I + b`` from the picture to the light have slopes of
    0..1 too, places its edges.
    """
    size, small_size = picture.shape[:2], before.shape
    seen = np.log(np.maximum(picture @ LUMINANCE_WEIGHTS, 0) + DARKEST)
    small = cv2.resize(seen, small_size[::-1], interpolation=cv2.INTER_AREA)
    skin = plain > 0

    def local(x: Float[ndarray, "p q"], sigma: float = LOCAL) -> Float[ndarray, "p q"]:
        return blurred(x[..., None], plain, sigma * on.face_px)[..., 0]

    middle = float(exact[skin].mean())
    if slope is None:
        slope = _slope(exact[skin], local(small, EXACT)[skin])
    known = middle + slope * (exact - middle)
    mine, its = local(small), local(known)
    a = (local(small * known) - mine * its) / (local(small**2) - mine**2 + TEXTURE**2)
    a = np.clip(a, 0, 1)
    a, b = local(a), local(its - a * mine)
    radius = max(2, round(EDGE * on.face_px * size[0] / small_size[0]))
    guide = cv2.ximgproc.guidedFilter(float32(seen), float32(seen), radius, PORES**2)
    lines = enlarged(np.dstack([a, b]), plain, size)
    own = resized(filled(before[..., None], on.face)[..., 0], size)
    own = own - lines[..., 0] * guide - lines[..., 1]
    wide = on.beyond(cv2.resize(own, small_size[::-1], interpolation=cv2.INTER_AREA))
    share, wide = (resized(each, size) for each in (on.share(), wide))
    return Unseen(
        level=share * own + (1 - share) * wide,
        slope=slope,
        contrast=float(local(small, EXACT)[skin].std()),
    )


def _slope(light: Float[ndarray, " n"], picture: Float[ndarray, " n"]) -> float:
    """Of the line from light to picture, 0 where the light hardly varies; a half counts as 1.

    What a head is off by lowers the slope of light that is right.
    """
    away = light - light.mean()
    least = 1e-3 * len(away)
    slope = float(away @ (picture - picture.mean()) / (away @ away + least))
    return min(max(2 * slope, 0.0), 1.0)


def soft_matte(
    picture: Float[ndarray, "h w 3"],
    matte: Float[ndarray, "h w"],
    head: Float[ndarray, "p q"],
    face_px: float,
) -> Float[ndarray, "h w"]:
    """The matte along the picture's edges, widened in clothes where there is none: a cut shows.

    ``face_px`` is the face's height in the pixels of ``head``.
    """
    size = (matte.shape[0], matte.shape[1])
    large_px = face_px * size[0] / len(head)
    # in codes: of smaller numbers its determinants of colours count as 0, and it only blurs
    guide = float32(255 * np.sqrt(np.clip(picture, 0, 1)))

    def followed(radius: float) -> Float[ndarray, "h w"]:
        radius_px = max(2, round(radius * large_px))
        return cv2.ximgproc.guidedFilter(guide, float32(matte), radius_px, CODES**2)

    near = resized(np.clip(2 * cv2.GaussianBlur(head, (0, 0), SPREAD * face_px), 0, 1), size)
    return np.clip(near * followed(EDGE) + (1 - near) * followed(SPREAD), 0, 1)
