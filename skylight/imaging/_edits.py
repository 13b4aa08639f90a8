"""Saturation and contrast, as cameras' picture styles and editors change them.

Both act on display values, which are about the power 1 / 2.2 of linear ones. With p the picture
before, relative to a pivot that contrast leaves as it is, and Y luminance::

    c = p^(1/2.2),    p' = max(0, 1 + k (Y(c) - 1) + s (c - Y(c)))^2.2.

An editor's ``saturate(a)`` and ``contrast(b)`` (W3C's Filter Effects; Pillow's ``Color`` and
``Contrast`` but for their luma, which is Rec.601's) are s = a b and k = b, in either order:
contrast of each channel raises saturation too, and told apart, what is taken for contrast does not
colour light. Editors turn contrast about a
middle grey; another pivot is another exposure, k and s, exactly. What is left: sRGB's curve is no
power (a face of light skin is off by 0.2 to 0.7 % of its mean for a and b of 0.8 to 1.5, and by 11
to 33 % without an edit), what an editor cuts off at white, and cameras' curves, which bend where
this is straight.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.sphere._envmap import LUMINANCE, luminance

DISPLAY_GAMMA = 2.2
_DARKEST = 1e-6  # of the pivot: what is darker counts as that, so that slopes are finite


def edited(
    linear: Float[Tensor, "*b m 3"],
    saturation: Float[Tensor, "*#b"],
    contrast: Float[Tensor, "*#b"],
) -> Float[Tensor, "*b m 3"]:
    """p' of the module's text, of a linear picture relative to its pivot."""
    s, k = saturation[..., None, None], contrast[..., None, None]
    shown = linear.clamp(min=_DARKEST) ** (1 / DISPLAY_GAMMA)
    luma = luminance(shown)[..., None]
    return (1 + k * (luma - 1) + s * (shown - luma)).clamp(min=0) ** DISPLAY_GAMMA


@dataclass(frozen=True, kw_only=True)
class PixelSlopes:
    """Derivatives J of three numbers of each pixel by three others: ``diag(own) + by a^T``.

    ``along`` is a; each of the three is (b,m,3).
    """

    own: Float[Tensor, "b m 3"]
    by: Float[Tensor, "b m 3"]
    along: Float[Tensor, "b m 3"]

    @staticmethod
    def unit(like: Float[Tensor, "b m 3"]) -> "PixelSlopes":
        """Of what stays as it is."""
        none = torch.zeros_like(like)
        return PixelSlopes(own=torch.ones_like(like), by=none, along=none)

    def __call__(self, changes: Float[Tensor, "b j m 3"]) -> Float[Tensor, "b j m 3"]:
        """J times each of j changes of all pixels."""
        amount = (changes * self.along[:, None]).sum(-1, keepdim=True)
        return torch.addcmul(amount * self.by[:, None], changes, self.own[:, None])

    def of(self, gains: Float[Tensor, "b 3"]) -> "PixelSlopes":
        """By what is multiplied by those first: J diag(gains)."""
        gains = gains[:, None]
        return replace(self, own=self.own * gains, along=self.along * gains)

    def then(self, scale: Float[Tensor, "#b #m #c"]) -> "PixelSlopes":
        """Of what is multiplied by those afterwards: diag(scale) J."""
        return replace(self, own=self.own * scale, by=self.by * scale)

    def grey(self) -> "PixelSlopes":
        """Of the luminance, in all channels."""
        weights = self.own.new_tensor(LUMINANCE)
        along = weights * self.own + luminance(self.by)[..., None] * self.along
        return PixelSlopes(own=torch.zeros_like(along), by=torch.ones_like(along), along=along)


def edited_slopes(
    linear: Float[Tensor, "b m 3"], saturation: Float[Tensor, " b"], contrast: Float[Tensor, " b"]
) -> tuple[PixelSlopes, Float[Tensor, "b 2 m 3"]]:
    """Derivatives of :func:`edited`: by the picture, and by log s and log k.

    With ``u = p'^(1/2.2)`` they are ``2.2 u^1.2`` times those of u, which are
    ``k Y(dc) + s (dc - Y(dc))`` with ``dc = c dp / (2.2 p)``, and ``s (c - Y(c))`` and
    ``k (Y(c) - 1)``. What is darker than the darkest that counts, or became 0, has none.
    """
    s, k = saturation[:, None, None], contrast[:, None, None]
    inside = linear.clamp(min=_DARKEST)
    shown = inside ** (1 / DISPLAY_GAMMA)
    luma = luminance(shown)[..., None]
    grey, hue = k * (luma - 1), s * (shown - luma)
    outer = DISPLAY_GAMMA * (1 + grey + hue).clamp(min=0) ** (DISPLAY_GAMMA - 1)
    inner = shown / (DISPLAY_GAMMA * inside) * (linear >= _DARKEST)
    slopes = PixelSlopes(
        own=outer * s * inner, by=outer * (k - s), along=inner * inner.new_tensor(LUMINANCE)
    )
    return slopes, outer[:, None] * torch.stack([hue, grey.expand_as(hue)], 1)


@dataclass(frozen=True, kw_only=True)
class Edit:
    """What was done to a picture after its light was measured; ``pivot`` in the picture's units."""

    saturation: float = 1.0
    contrast: float = 1.0
    pivot: float = 1.0

    def apply(self, linear: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3"]:
        """The picture, in linear values, of what the camera saw."""
        if self.saturation == self.contrast == 1:
            return linear
        numbers = (linear.new_tensor(x) for x in (self.saturation, self.contrast))
        flat = linear.reshape(-1, 3) / self.pivot
        return (self.pivot * edited(flat, *numbers)).reshape(linear.shape)

    def undo(self, picture: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3"]:
        """What the camera saw; of values that the edit made 0, the most that it can have been."""
        if self.saturation == self.contrast == 1:
            return picture
        shown = (picture.clamp(min=0) / self.pivot) ** (1 / DISPLAY_GAMMA)
        luma = luminance(shown)[..., None]
        before = 1 + (luma - 1) / self.contrast + (shown - luma) / self.saturation
        return self.pivot * before.clamp(min=0) ** DISPLAY_GAMMA


UNEDITED = Edit()
