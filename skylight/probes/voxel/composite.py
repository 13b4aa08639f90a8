"""A drawing put into the photograph whose light it was drawn with."""

import numpy as np
from jaxtyping import UInt8

from skylight.probes.capture.response import Response
from skylight.probes.voxel.render import WHOLE, Drawing, Window


def composite(
    image: UInt8[np.ndarray, "h w 3"],
    drawing: Drawing,
    response: Response,
    window: Window = WHOLE,
) -> UInt8[np.ndarray, "h w 3"]:
    """Mixed in linear light and encoded as the camera does; other pixels keep their codes.

    The drawing is that of ``window``.
    """
    covered = drawing.alpha.numpy() > 0
    out = image.copy()
    part = out[window]
    if not covered.any():
        return out
    codes = np.ascontiguousarray(part[covered][None])
    behind = 1 - drawing.alpha[drawing.alpha > 0, None]
    mixed = drawing.radiance[drawing.alpha > 0] + behind * response.linearise(codes)[0]
    part[covered] = response.encode(mixed[None])[0]
    return out
