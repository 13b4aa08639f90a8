"""A ColorChecker drawn into a scene: its published greys, and colours to recognise it by."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float

# CIE L*a*b* (GretagMacbeth 2005), but for the greys; only to be recognised by
COLOURS = [
    (38, 14, 14), (66, 18, 18), (50, -5, -22), (43, -13, 22), (55, 9, -25), (71, -33, 0),
    (63, 36, 57), (40, 10, -46), (51, 48, 16), (30, 23, -22), (73, -24, 57), (72, 19, 68),
    (29, 14, -50), (55, -38, 31), (42, 53, 28), (82, 4, 80), (52, 50, -15), (51, -29, -29),
]  # fmt: skip

# CIE xyY under D50 from white to black: the averages over 30 charts (BabelColor 2012)
GREYS = [
    (0.3488, 0.3628, 0.9129), (0.3451, 0.3596, 0.5885), (0.3446, 0.3590, 0.3595),
    (0.3438, 0.3589, 0.1912), (0.3423, 0.3576, 0.0893), (0.3439, 0.3565, 0.0320),
]  # fmt: skip
# Of charts made since November 2014, by their published L*
NEW_LIGHTNESS = (95.19, 81.29, 66.89, 50.76, 35.63, 20.64)


def grey_albedos(*, new: bool = False) -> Float[np.ndarray, "6 3"]:
    """Linear Rec.709 under D65, by Bradford's adaptation and the definition of Rec.709."""
    x, y, luminance = np.array(GREYS).T
    if new:
        luminance = ((np.array(NEW_LIGHTNESS) + 16) / 116) ** 3

    def tristimulus(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.stack([x / y, np.ones_like(y), (1 - x - y) / y], -1)

    cones = np.array(
        [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
    )
    d50, d65 = (tristimulus(*map(np.array, white)) for white in ((0.3457, 0.3585), (0.3127, 0.329)))
    adapted = np.linalg.inv(cones) @ np.diag((cones @ d65) / (cones @ d50)) @ cones
    primaries = tristimulus(np.array([0.64, 0.30, 0.15]), np.array([0.33, 0.60, 0.06])).T
    to_xyz = primaries * np.linalg.solve(primaries, d65)
    xyz = luminance[:, None] * tristimulus(x, y)
    return xyz @ (np.linalg.inv(to_xyz) @ adapted).T


def lay_chart(
    scene: Float[np.ndarray, "h w 3"], corners: Sequence[Sequence[float]], *, new: bool = False
) -> None:
    """Draw its albedos over those of the scene, its four corners (x, y) there.

    ``new``: with the greys of charts made since November 2014.
    """
    width, gap = 120, 24
    page = np.full((4 * width + 5 * gap, 6 * width + 7 * gap, 3), 0.02, np.float32)
    lab = np.array([COLOURS], dtype=np.float32)
    colours = np.clip(cv2.cvtColor(lab, cv2.COLOR_LAB2RGB)[0], 0, 1) ** 2.2
    for i, colour in enumerate([*colours, *grey_albedos(new=new)]):
        y, x = (gap + n * (width + gap) for n in divmod(i, 6))
        page[y : y + width, x : x + width] = colour
    h, w = page.shape[:2]
    source = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32)
    turn = cv2.getPerspectiveTransform(source, np.array(corners, np.float32))
    cv2.warpPerspective(
        page, turn, scene.shape[1::-1], dst=scene, flags=cv2.INTER_AREA,
        borderMode=cv2.BORDER_TRANSPARENT,
    )  # fmt: skip
