"""How a new light changes a picture: smooth, bounded gains that the picture's own edges place.

A fitted head is off by some hundredths of its height and the light found by some degrees, so a
ratio of shadings that is sharper than that is wrong beside every edge. Here a light's
:class:`Level` is the expectation of its shading over such errors, as a normalised convolution;
gains are differences of logarithms of two lights' levels.

Of the old light only what the picture shows is taken away (:func:`unseen`): shadows are removed
where the picture has them, and those that it lacks are not inverted.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, Shaped
from numpy import ndarray

from skylight.sphere._envmap import LUMINANCE

# Lengths are in heights of the face.
SHARP = 0.02  # standard deviation of the Gaussian of skin's shading: what a fitted head is off by
SOFT = 0.05  # and of that of hair and clothes
TINT = 0.12  # and of the colour of light
EXACT = 0.01  # and of the shading whose edges the picture places
LOCAL = 0.05  # and of the neighbourhood in which shading is compared with the picture
EDGE = 0.02  # radius of the guided filter that tells shading's edges from texture
SPREAD = 0.1  # and of the one of the matte in clothes
CODES = 8.0  # of 255: less is no edge of a person
# Logarithms.
BRIGHTER, DARKER, TINTED = 1.0, 2.0, 0.1  # what gains approach on either side of skin's mean
TEXTURE = 0.05  # standard deviation of skin's albedo
CLOTH = 0.5  # and what no skin's differs by from a face's mean, over all channels
HUE = 0.15  # what skin's own colour differs by from place to place
PORES = 0.15  # what the guided filter takes for texture
BASE = 0.04  # of the mean shading, in addition: light that bounces between the parts of a face
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
    """Where a picture of shading shows skin (``bare``) and any surface (``covered``)."""

    bare: Float[ndarray, "p q"]
    covered: Float[ndarray, "p q"]
    face_px: float

    def mean(self, picture: Float[ndarray, "p q c"]) -> Float[ndarray, " c"]:
        """Over the skin."""
        return picture[self.bare > 0].mean(0)


@dataclass(frozen=True, kw_only=True)
class Level:
    """Light on a person as far as it is known, in logarithms.

    ``level`` is the luminance of diffuse and, in part, specular reflection of albedo 1, ``colour``
    each channel over the luminance.
    """

    level: Float[ndarray, "p q"]
    colour: Float[ndarray, "p q 3"]

    @staticmethod
    def of(
        shading: Float[ndarray, "p q 3"],
        specular: Float[ndarray, "p q 3"],
        on: Surface,
        sharp: float = SHARP,
    ) -> "Level":
        """``ln(E[S + SHINE g] + BASE mean(S))``; ``specular`` is over the albedo."""
        whole = ((shading + SHINE * specular) @ LUMINANCE_WEIGHTS)[..., None]
        near, far = (blurred(whole, on.covered, x * on.face_px) for x in (sharp, SOFT))
        skin = blurred(on.bare[..., None], on.covered, SHARP * on.face_px)
        base = BASE * float(on.mean(shading) @ LUMINANCE_WEIGHTS)
        level = np.log(np.maximum(skin * near + (1 - skin) * far + base, 1e-9))[..., 0]
        wide = blurred(shading, on.covered, TINT * on.face_px)
        colour = wide / np.maximum(wide @ LUMINANCE_WEIGHTS, 1e-9)[..., None]
        return Level(level=level, colour=np.log(np.maximum(colour, 1e-3)))


def bounded(
    gain: Float[ndarray, "*s"], brighter: float | Float[ndarray, "*s"] = BRIGHTER
) -> Float[ndarray, "*s"]:
    """A logarithm with a soft knee: ``b tanh(x / b)``, b of its sign.

    Shadows brightened further show noise, which e times the light makes ``e^(1 / 2.4)``, 1.5 times
    as large in a picture's codes; skin darkened further loses its texture.
    """
    limit = np.where(gain > 0, np.float32(brighter), np.float32(DARKER))
    return limit * np.tanh(gain / limit)


def tinted(
    tint: Float[ndarray, "p q 3"],
    gain: Float[ndarray, "p q"],
    skin: Float[ndarray, "p q 3"],
    on: Surface,
) -> Float[ndarray, "p q 3"]:
    """Changes of colour within :data:`TINTED` of skin's mean, and ``skin`` where light changes.

    ``m + b tanh((t - m) / b) + (1 - exp(-|x|)) s``, x being the ``gain`` of level.
    """
    mean = on.mean(tint)
    near = mean + TINTED * np.tanh((tint - mean) / TINTED)
    return near + (1 - np.exp(-np.abs(gain)))[..., None] * skin


@dataclass(frozen=True, kw_only=True)
class Unseen:
    """What of the old light's variation the picture does not show, so that it is not taken away.

    ``level`` (h,w) is at the picture's pixels, ``colour`` at those of shading. ``skin`` is what a
    place lacks to the mean colour of skin, whose shadows are grey in a photograph: with the light
    of a place its colour changes towards that mean (:func:`tinted`). ``slope`` is how
    much of the light's variation over skin the picture shows in all, from 0 to 1, and ``contrast``
    the standard deviation of the picture's logarithm there.
    """

    level: Float[ndarray, "h w"]
    colour: Float[ndarray, "p q 3"]
    skin: Float[ndarray, "p q 3"]
    slope: float
    contrast: float


def unseen(
    picture: Float[ndarray, "h w 3"],
    before: Level,
    exact: Level,
    plain: Float[ndarray, "p q"],
    on: Surface,
) -> Unseen:
    """Of a linear picture, the old light, the same with its edges, and where albedo is ``plain``.

    The picture's slope over the light's is bounded to 0..1 for all of the skin, then a guided
    filter (He et al. 2013), whose lines ``a I + b`` from the picture to the light have slopes of
    0..1 too, places its edges.
    """
    size, small_size = picture.shape[:2], before.level.shape
    seen = np.log(np.maximum(picture @ LUMINANCE_WEIGHTS, 0) + DARKEST)
    small = cv2.resize(seen, small_size[::-1], interpolation=cv2.INTER_AREA)
    skin = plain > 0

    def local(x: Float[ndarray, "p q"], sigma: float = LOCAL) -> Float[ndarray, "p q"]:
        return blurred(x[..., None], plain, sigma * on.face_px)[..., 0]

    middle = float(exact.level[skin].mean())
    slope = _slope(exact.level[skin], local(small, EXACT)[skin])
    known = middle + slope * (exact.level - middle)
    mine, its = local(small), local(known)
    a = (local(small * known) - mine * its) / (local(small**2) - mine**2 + TEXTURE**2)
    a = np.clip(a, 0, 1)
    a, b = local(a), local(its - a * mine)
    radius = max(2, round(EDGE * on.face_px * size[0] / small_size[0]))
    guide = cv2.ximgproc.guidedFilter(float32(seen), float32(seen), radius, PORES**2)
    lines = enlarged(np.dstack([a, b]), plain, size)
    whole = enlarged(np.dstack([before.level, known]), on.covered, size)
    inside = cv2.erode(on.bare, np.ones((3, 3), np.uint8))
    share = resized(cv2.GaussianBlur(inside, (0, 0), EDGE * on.face_px), size)
    colour, lacking = _unseen_colour(picture, before.colour, plain, on)
    placed = lines[..., 0] * guide + lines[..., 1]
    return Unseen(
        level=whole[..., 0] - share * placed - (1 - share) * whole[..., 1],
        colour=colour,
        skin=lacking,
        slope=slope,
        contrast=float(local(small, EXACT)[skin].std()),
    )


def _unseen_colour(
    picture: Float[ndarray, "h w 3"],
    colour: Float[ndarray, "p q 3"],
    plain: Float[ndarray, "p q"],
    on: Surface,
) -> tuple[Float[ndarray, "p q 3"], Float[ndarray, "p q 3"]]:
    """``colour`` and ``skin`` of :class:`Unseen`."""
    small = cv2.resize(picture, plain.shape[::-1], interpolation=cv2.INTER_AREA)
    small = np.maximum(small, 0) + np.float32(1e-4)
    shown = blurred(small, plain, TINT * on.face_px) + np.float32(1e-9)
    shown = np.log(shown / (shown @ LUMINANCE_WEIGHTS)[..., None])
    skin = plain > 0
    slopes = np.array([_slope(colour[skin][:, k], shown[skin][:, k]) for k in range(3)], np.float32)
    # where no skin shows the colour of light, as on cloth of any colour, nothing tells that it was
    # there: taken away, it would turn white cream
    bare = blurred(on.bare[..., None], on.covered, SHARP * on.face_px)
    hidden = (1 - slopes * bare) * (colour - colour[skin].mean(0))
    mean = np.log(small[skin].mean(0) / (small[skin].mean(0) @ LUMINANCE_WEIGHTS))
    near = blurred(small, plain, LOCAL * on.face_px) + np.float32(1e-9)
    lacks = mean - np.log(near / (near @ LUMINANCE_WEIGHTS)[..., None])
    # a collar before the neck has none of skin's colour, though it is as bright
    alike = np.maximum(1 - (lacks**2).sum(2) / CLOTH**2, 0) ** 2
    dark = np.clip(
        2 - 2 * (near @ LUMINANCE_WEIGHTS) / float(small[skin].mean(0) @ LUMINANCE_WEIGHTS), 0, 1
    )
    share = cv2.GaussianBlur(plain, (0, 0), EDGE * on.face_px) * np.maximum(alike, dark)
    return hidden, share[..., None] * HUE * np.tanh(lacks / HUE)


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
