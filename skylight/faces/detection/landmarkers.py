"""The landmarkers by name."""

from functools import cache

from skylight.errors import InputError
from skylight.faces.detection.dlib_landmarks import DlibLandmarker
from skylight.faces.detection.mediapipe_face import MediaPipeLandmarker
from skylight.faces.landmarks import FaceLandmarker
from skylight.faces.names import LandmarkerName


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
