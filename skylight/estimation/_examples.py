"""Photographs to try the estimate on, which scikit-image installs, and what comes of each.

They stand by themselves so that the studio's server, which offers them, imports no torch.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray


@dataclass(frozen=True, kw_only=True)
class ExamplePhoto:
    """``codes()`` are its 8-bit sRGB pixels; ``expected`` says whether its light is found."""

    name: str
    author: str
    licence: str
    description: str
    expected: str
    codes: Callable[[], UInt8[ndarray, "h w 3"]]


def _astronaut() -> UInt8[ndarray, "h w 3"]:
    from skimage.data import astronaut

    return astronaut()


def _cameraman() -> UInt8[ndarray, "h w 3"]:
    from skimage.data import camera

    return np.repeat(camera()[..., None], 3, axis=2)


EXAMPLES = (
    ExamplePhoto(
        name="astronaut",
        author="NASA",
        licence="public domain",
        description="Portrait of the astronaut Eileen Collins",
        expected="works: a studio's flat light",
        codes=_astronaut,
    ),
    ExamplePhoto(
        name="cameraman",
        author="Lav Varshney",
        licence="CC0",
        description="A man in profile behind a camera, in black and white",
        expected="fails, and says so: a face in profile",
        codes=_cameraman,
    ),
)
