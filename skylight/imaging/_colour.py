"""Transfer curves between linear and display values, and a simple tone map.

The sRGB curves are written out, although kornia has them, because pixels and radiances here have
the channel last or are bare lists of values; kornia's serve as the tests' oracle.
"""

from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.errors import InputError
from skylight.sphere._envmap import luminance

# How a picture's values encode light: a named curve, or the exponent of a power law.
Decode = Literal["srgb", "linear"] | float


def srgb_to_linear(encoded: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """c / 12.92 up to 0.04045, then ((c + 0.055) / 1.055)^2.4 (IEC 61966-2-1:1999, 5.2)."""
    # the clamp keeps the hidden branch's gradient finite
    power = ((encoded.clamp(min=0.04045) + 0.055) / 1.055) ** 2.4
    return torch.where(encoded > 0.04045, power, encoded / 12.92)


def linear_to_srgb(linear: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """12.92 x up to 0.0031308, then 1.055 x^(1/2.4) - 0.055 (IEC 61966-2-1:1999, 5.2)."""
    power = 1.055 * linear.clamp(min=0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(linear > 0.0031308, power, 12.92 * linear)


def decode_gamma(encoded: Float[Tensor, "*s"], gamma: float) -> Float[Tensor, "*s"]:
    """c^gamma; values below 0 count as 0."""
    return encoded.clamp(min=0) ** gamma


def encode_gamma(linear: Float[Tensor, "*s"], gamma: float) -> Float[Tensor, "*s"]:
    """x^(1/gamma), with a straight line below 1e-6 so that the gradient at 0 is finite."""
    toe = 1e-6
    power = linear.clamp(min=toe) ** (1 / gamma)
    return torch.where(linear > toe, power, linear * toe ** (1 / gamma - 1))


def decode_values(encoded: Float[Tensor, "*s"], decode: Decode) -> Float[Tensor, "*s"]:
    """Linear light of encoded values: "srgb", "linear", or the exponent of a power law."""
    if decode == "srgb":
        return srgb_to_linear(encoded)
    if decode == "linear":
        return encoded
    if isinstance(decode, int | float) and 0 < decode < 10:
        return decode_gamma(encoded, decode)
    raise InputError(
        f"unknown decoding {decode!r}: choose srgb, linear, or a gamma above 0 such as 2.2"
    )


def encode_values(linear: Float[Tensor, "*s"], encoding: Decode) -> Float[Tensor, "*s"]:
    """The inverse of :func:`decode_values` for linear light >= 0."""
    if encoding == "srgb":
        return linear_to_srgb(linear)
    if isinstance(encoding, int | float) and 0 < encoding < 10:
        return encode_gamma(linear, encoding)
    if encoding == "linear":
        return linear
    raise InputError(
        f"unknown encoding {encoding!r}: choose srgb, linear, or a gamma above 0 such as 2.2"
    )


def tone_map(
    radiance: Float[Tensor, "*s 3"], *, quantile: float = 0.98, white: float | None = None
) -> UInt8[np.ndarray, "*s 3"]:
    """Radiance as sRGB codes for looking at: round(255 srgb(min(1, L / white))).

    ``white`` is the luminance shown as full white; by default the ``quantile`` of the picture's
    own luminance over its pixels (its maximum where that quantile is dark). Give the same white
    to pictures that are to be compared.
    """
    value = radiance.detach().to("cpu", torch.float32)
    if white is None:
        level = luminance(value).flatten()
        # kthvalue, because torch.quantile refuses more than 2^24 values
        white = float(level.kthvalue(max(1, round(quantile * level.numel()))).values)
        white = white if white > 0 else float(level.max())
    shown = linear_to_srgb((value / max(white, 1e-30)).clamp(0, 1))
    return (255 * shown).round().to(torch.uint8).numpy()
