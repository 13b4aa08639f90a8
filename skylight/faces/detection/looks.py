"""Pictures of a picture in which BlazeFace finds more: turned, brightened, with a mirrored margin.

BlazeFace was trained on faces that are whole, lit and about upright. A face that fills its picture
is whole where the picture is continued by its mirror image, a dark one is lit where local contrast
is raised (CLAHE, Zuiderveld 1994), and a tilted one stands where the picture is turned.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from skylight.faces.detection.blazeface import LEAST_SCORE, Square

Picture = UInt8[ndarray, "h w 3"]
Shown = UInt8[ndarray, "h2 w2 3"]
_LOWEST_SCORE = 0.3  # where a face must be sure by its landmarks
_TURNS_DEG = (45.0, -45.0, 90.0, -90.0)
_CLIP_LIMIT, _TILES = 4.0, (4, 4)  # of CLAHE


@dataclass(frozen=True, kw_only=True)
class Look:
    """``shown``, whose point p shows point ``back[:, :2] @ p + back[:, 2]`` of ``picture``.

    BlazeFace looks at ``shown``, landmarks are read in ``picture``: in a margin they would follow
    the mirror image. Candidates count from BlazeFace's ``least_score`` on. ``last_resort``: false
    faces are likelier than in the picture itself, so what is found must be sure.
    """

    picture: Picture
    shown: Shown
    back: Float[ndarray, "2 3"]
    least_score: float = _LOWEST_SCORE
    last_resort: bool = True

    def in_picture(self, square: Square) -> Square:
        """A square of ``shown`` where it is in ``picture``."""
        cos, sin = self.back[:, 0]
        return Square(
            centre=self.back[:, :2] @ square.centre + self.back[:, 2],
            side=square.side,
            angle_rad=square.angle_rad + float(np.arctan2(sin, cos)),
        )


def looks(image: Picture) -> Iterator[Look]:
    """The picture itself, then what else may show a face; made when asked for."""
    itself = np.eye(2, 3)
    yield Look(picture=image, shown=image, back=itself, least_score=LEAST_SCORE, last_resort=False)
    for picture in (image, brightened(image)):
        yield Look(picture=picture, shown=picture, back=itself)
        shown, back = mirrored(picture)
        yield Look(picture=picture, shown=shown, back=back)
        for degrees in _TURNS_DEG:
            shown, back = turned(picture, degrees)
            yield Look(picture=picture, shown=shown, back=back)


def mirrored(image: Picture) -> tuple[Shown, Float[ndarray, "2 3"]]:
    """(a picture with its mirror image around it, half its height wide; the way back)."""
    margin = image.shape[0] // 2
    wide = cv2.copyMakeBorder(image, margin, margin, margin, margin, cv2.BORDER_REFLECT)
    return wide, np.array([[1.0, 0.0, -margin], [0.0, 1.0, -margin]])


def brightened(image: Picture) -> Picture:
    """Local contrast raised, colours kept: CLAHE of CIELAB's lightness."""
    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB)
    lab[..., 0] = cv2.createCLAHE(_CLIP_LIMIT, _TILES).apply(lab[..., 0])
    return cv2.cvtColor(lab, cv2.COLOR_LAB2RGB)


def turned(image: Picture, angle_deg: float) -> tuple[Shown, Float[ndarray, "2 3"]]:
    """(the whole picture turned clockwise as it is seen, black around it; the way back)."""
    angle = np.radians(angle_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    source = np.array(image.shape[1::-1], dtype=np.float64)
    size = np.ceil(np.abs(turn) @ source - 1e-6).astype(int)
    back = np.column_stack([turn.T, source / 2 - turn.T @ (size / 2)])
    centres = back.copy()  # OpenCV's integers name pixel centres
    centres[:, 2] += back[:, :2] @ [0.5, 0.5] - 0.5
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(image, centres, (int(size[0]), int(size[1])), flags=flags), back
