"""Detection of faces and their 68 landmarks, with an interface for other detectors.

Pictures of a picture in which BlazeFace finds more: turned, brightened, with a mirrored margin.

BlazeFace was trained on faces that are whole, lit and about upright. A face that fills its picture
is whole where the picture is continued by its mirror image, a dark one is lit where local contrast
is raised (CLAHE, Zuiderveld 1994), and a tilted one stands where the picture is turned.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from typing import Protocol, runtime_checkable
from zipfile import BadZipFile

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from skylight.errors import AssetError, InputError
from skylight.faces._blazeface import LEAST_SCORE, Square
from skylight.faces._names import LandmarkerName

# Outer corners of the eyes, the person's right first: of iBUG's 68 points, and of MediaPipe's 478.
EYES: tuple[int, int] = (36, 45)
MESH_EYES: tuple[int, int] = (33, 263)


@dataclass(frozen=True, kw_only=True)
class DetectedFace:
    """``points`` (68,2) in iBUG's order, (x, y) pixels with pixel centres at +0.5.

    ``score`` is the detector's; below 0 it is a guess where nothing better was seen. ``readings``
    are several of MediaPipe's 478 points, from the same face seen a little differently: where they
    are given the head is fitted to them, else to ``points`` with the errors that dlib's have.
    """

    points: Float[np.ndarray, "68 2"]
    score: float
    readings: Float[np.ndarray, "r 478 2"] | None = None

    @property
    def size_px(self) -> float:
        """Diagonal of the landmarks' bounding box."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    @property
    def eye_distance_px(self) -> float:
        """Between the outer corners of the eyes: what landmark errors are measured against."""
        right, left = EYES
        return float(np.linalg.norm(self.points[left] - self.points[right]))


@runtime_checkable
class FaceLandmarker(Protocol):
    """Anything that finds faces and their 68 landmarks."""

    def detect(self, image: UInt8[np.ndarray, "h w 3"]) -> list[DetectedFace]:
        """All faces of an sRGB picture, the largest first; an empty list where there is none."""
        ...


def choose_face(faces: list[DetectedFace], number: int, source: str) -> DetectedFace:
    """Face ``number`` (1 is the largest), or an error that says what was found."""
    if not faces:
        raise InputError(
            f"{source}: no face found; use a picture with a face seen from the front, at least "
            "60 pixels high"
        )
    if not 1 <= number <= len(faces):
        raise InputError(
            f"{source}: there is no face {number}, only {len(faces)} found; "
            f"choose --face 1 to {len(faces)}"
        )
    return faces[number - 1]


def landmark_errors(landmarker: LandmarkerName) -> dict[str, np.ndarray]:
    """Arrays of what a landmarker errs by on rendered people (``tools/measure_landmarks.py``).

    Raises
    ------
    AssetError
        The file is missing or damaged.
    """
    source = files("skylight.faces") / "data" / f"{landmarker}_landmarks.npz"
    try:
        with source.open("rb") as stream, np.load(stream) as stored:
            return {name: stored[name].astype(np.float64) for name in stored}
    except (OSError, KeyError, ValueError, BadZipFile) as error:
        raise AssetError(
            f"{source}: the landmark errors cannot be read ({error}); reinstall skylight"
        ) from error


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
