"""Faces with their 68 landmarks: the interface of what finds them, and which of them are meant."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from skylight._names import LandmarkerName, WhichFaces
from skylight.errors import AssetError, InputError
from skylight.imaging._photo import Photo
from skylight.io._bounded import load_arrays
from skylight.work._progress import Progress

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


@dataclass(frozen=True, kw_only=True)
class FoundFace:
    """Face ``number`` (1 is the largest) of photograph ``photo``, counted from 0."""

    photo: int
    number: int
    name: str
    face: DetectedFace


def find_faces(
    photos: Sequence[Photo],
    names: Sequence[str],
    which: WhichFaces,
    landmarker: FaceLandmarker,
    progress: Progress,
) -> tuple[list[FoundFace], list[str]]:
    """All faces, or face ``which`` of each photograph; and why photographs have none."""
    found: list[FoundFace] = []
    missing: list[str] = []
    for photo, (picture, name) in enumerate(zip(photos, names, strict=True)):
        detected = landmarker.detect(picture.encoded)
        try:
            numbers = range(1, max(1, len(detected)) + 1) if which == "all" else [which]
            for n in numbers:
                face = choose_face(detected, n, name)
                label = f"{name}, face {n}" if which == "all" else name
                found.append(FoundFace(photo=photo, number=n, name=label, face=face))
        except InputError as error:
            missing.append(str(error))
        progress((photo + 1) / len(photos))
    return found, missing


def landmark_errors(landmarker: LandmarkerName, *names: str) -> list[Float[np.ndarray, "..."]]:
    """What a landmarker errs by on rendered people (``tools/measure_landmarks.py``)."""
    stored = shipped_arrays("skylight.faces", f"{landmarker}_landmarks.npz", *names)
    return [stored[name].astype(np.float64) for name in names]


def shipped_arrays(package: str, file: str, *names: str) -> dict[str, np.ndarray]:
    """Arrays of a .npz file that comes with a package of skylight."""
    path = Path(str(files(package) / "data" / file))
    try:
        return load_arrays(path, names)
    except (OSError, ValueError) as error:
        raise AssetError(f"{path} cannot be read ({error}); reinstall skylight") from error
