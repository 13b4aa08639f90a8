"""The landmarkers by name: MediaPipe's, and dlib's 68 landmarks (research use, extra ``dlib``)."""

import importlib
import importlib.metadata
import threading
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from skylight._names import LandmarkerName
from skylight.errors import AssetError, InputError, not_installed
from skylight.faces._landmarks import DetectedFace, FaceLandmarker
from skylight.faces._mediapipe import MediaPipeLandmarker

WEAKEST_SHARE = 0.15
WEAKEST_SCORE = -0.3  # of dlib's detector, whose faces have 0 and more
_PREDICTOR = "face_recognition_models/models/shape_predictor_68_face_landmarks.dat"
_BY_DLIB = "finding landmarks as the thesis does, for research only,"
_DETECTION_SIDE_PX = 800  # dlib's detector finds faces of 80 px and more; larger costs only time


class DlibLandmarker:
    """dlib's frontal detector with the 68-point regression trees of Kazemi & Sullivan (2014).

    The thesis' own landmarks; the trees' training data exclude commercial use.

    Raises
    ------
    DependencyError
        The extra is not installed.
    AssetError
        Its model is missing.
    """

    def __init__(self) -> None:
        try:
            self._dlib: Any = importlib.import_module("dlib")  # without type stubs
        except ImportError as error:
            raise not_installed("dlib", _BY_DLIB) from error
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


def predictor_path() -> Path:
    """Where the 68-point model lies, by the metadata of the package that carries it."""
    try:
        package = importlib.metadata.distribution("face_recognition_models")
    except importlib.metadata.PackageNotFoundError as error:
        raise not_installed("dlib", _BY_DLIB) from error
    path = Path(str(package.locate_file(_PREDICTOR)))
    if not path.is_file():
        raise AssetError(f"{path}: dlib's landmark model is missing; reinstall its package")
    return path


@cache
def choose_landmarker(name: LandmarkerName = "mediapipe") -> FaceLandmarker:
    """What finds faces, one a process: its models are loaded once.

    Raises
    ------
    InputError
        No such landmarker.
    DependencyError
        dlib's is an extra that is not installed.
    """
    if name == "mediapipe":
        return MediaPipeLandmarker()
    if name != "dlib":
        raise InputError(f"{name!r} is no landmarker; choose mediapipe or dlib")
    return DlibLandmarker()
