"""A drawing put into the photograph whose light it was drawn with."""

import numpy as np
from jaxtyping import UInt8

from skylight.probes.capture.response import Response
from skylight.probes.voxel.render import Drawing


def composite(
    image: UInt8[np.ndarray, "h w 3"], drawing: Drawing, response: Response
) -> UInt8[np.ndarray, "h w 3"]:
    """Mixed in linear light and encoded as the camera does; other pixels keep their codes."""
    covered = drawing.alpha.numpy() > 0
    if not covered.any():
        return image.copy()
    codes = np.ascontiguousarray(image[covered][None])
    behind = 1 - drawing.alpha[drawing.alpha > 0, None]
    mixed = drawing.radiance[drawing.alpha > 0] + behind * response.linearise(codes)[0]
    out = image.copy()
    out[covered] = response.encode(mixed[None])[0]
    return out
