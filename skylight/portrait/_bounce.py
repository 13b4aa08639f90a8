"""Light that a person's own skin and clothes send into hollows: eye sockets, under nose and chin.

What a point's horizon hides of the light is the person, who is lit too. A lamp from above that
leaves an eye socket in the shadow of its brow lights the cheek below, and the socket receives that,
redder by the skin's colour. Without it shadows of the face are sooty.

A point of openness o, the share of an even light that reaches it, receives of albedo a ::

    B = M a (1 - o) / (1 - a (1 - o)),

M being the mean of direct light over the skin in its surroundings (:data:`AROUND`). That is
exact, all bounces included, inside an integrating sphere of that albedo, where what is hidden sees
what is lit wherever it lies; of other hollows M is only a guess. What hides the light counts as
skin, clothes and hair too, and the albedo is that of usual skin (:data:`ALBEDO`), for a photograph
does not tell it from the strength of its light: where o is 0.7, light is by 12 % of M brighter, and
would be by 3 to 22 % for the darkest and the palest skin.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from skylight.portrait._gain import LUMINANCE_WEIGHTS, blurred

AROUND = 0.2  # of a face's height: standard deviation of the surroundings that a hollow sees
ALBEDO = 0.35  # of skin in luminance: measured ones have 0.1 to 0.6 (Cooksey and Allen 2013)


def bounced(
    direct: Float[ndarray, "p q"],
    openness: Float[ndarray, "p q"],
    traced: Float[ndarray, "p q"],
    face_px: float,
) -> Float[ndarray, "p q"]:
    """B of the module's text, in luminance and 0 where no light was ``traced`` to."""
    mean = blurred(direct[..., None], traced, AROUND * face_px)[..., 0]
    hidden = ALBEDO * np.clip(1 - openness, 0, 1)
    return traced * mean * hidden / (1 - hidden)


def hollow_tint(shares: Float[ndarray, "*s"], hue: Float[ndarray, "3"]) -> Float[ndarray, "*s 3"]:
    """Logarithm of light's colour where a share of its luminance came from skin of that ``hue``.

    ``ln(1 + u (h - 1))``, h being the skin's albedo in each channel over its luminance.
    """
    return np.log1p(shares[..., None] * (hue - 1))


def hue_of(colour: Float[ndarray, "3"]) -> Float[ndarray, "3"]:
    """h of :func:`hollow_tint`, of a logarithm: its luminance is 1."""
    hue = np.exp(colour)
    return np.maximum(hue / (hue @ LUMINANCE_WEIGHTS), 1e-3)
