"""A ColorChecker drawn into a scene: its published greys, and colours to recognise it by."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float

from skylight.probes.chart.chart import GREYS

# CIE L*a*b* (GretagMacbeth 2005), but for the greys; only to be recognised by
COLOURS = [
    (38, 14, 14), (66, 18, 18), (50, -5, -22), (43, -13, 22), (55, 9, -25), (71, -33, 0),
    (63, 36, 57), (40, 10, -46), (51, 48, 16), (30, 23, -22), (73, -24, 57), (72, 19, 68),
    (29, 14, -50), (55, -38, 31), (42, 53, 28), (82, 4, 80), (52, 50, -15), (51, -29, -29),
]  # fmt: skip


def lay_chart(scene: Float[np.ndarray, "h w 3"], corners: Sequence[Sequence[float]]) -> None:
    """Draw its albedos over those of the scene, its four corners (x, y) there."""
    width, gap = 120, 24
    page = np.full((4 * width + 5 * gap, 6 * width + 7 * gap, 3), 0.02, np.float32)
    lab = np.array([COLOURS], dtype=np.float32)
    colours = np.clip(cv2.cvtColor(lab, cv2.COLOR_LAB2RGB)[0], 0, 1) ** 2.2
    for i, colour in enumerate([*colours, *GREYS]):
        y, x = (gap + n * (width + gap) for n in divmod(i, 6))
        page[y : y + width, x : x + width] = colour
    h, w = page.shape[:2]
    source = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32)
    turn = cv2.getPerspectiveTransform(source, np.array(corners, np.float32))
    cv2.warpPerspective(
        page, turn, scene.shape[1::-1], dst=scene, flags=cv2.INTER_AREA,
        borderMode=cv2.BORDER_TRANSPARENT,
    )  # fmt: skip
