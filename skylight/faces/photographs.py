"""The faces of photographs: detected, chosen, and fitted with a head."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from skylight.errors import InputError
from skylight.faces.fit import FaceFit, fit_face
from skylight.faces.landmarks import (
    DetectedFace,
    FaceLandmarker,
    choose_face,
)
from skylight.faces.model import HeadModel
from skylight.faces.names import HeadName, WhichFaces
from skylight.imaging.photo import Photo
from skylight.work.progress import Progress

MOST_TURNED_RAD = math.radians(60)


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


def fit_visible(
    model: HeadModel, photo: Photo, face: DetectedFace, name: str, head: HeadName = "fitted"
) -> FaceFit:
    """The head of a face that is turned away by no more than 60 degrees.

    ``head`` is "fitted", the morphable model's, or "deformed": bent to meet the landmarks, see
    :func:`~skylight.faces.fit.fit_face`.

    Raises
    ------
    InputError
        It is turned further: most of what the light does is out of sight. Or no such ``head``.
    """
    if head not in ("fitted", "deformed"):
        raise InputError(f"{head!r} is no head; choose fitted or deformed")
    height, width = photo.encoded.shape[:2]
    fit = fit_face(
        model, face, width, height, focal_px=photo.focal_px, meet_landmarks=head == "deformed"
    )
    if fit.facing_angle_rad > MOST_TURNED_RAD:
        raise InputError(
            f"{name}: the face is turned away by {math.degrees(fit.facing_angle_rad):.0f} "
            "degrees; use a picture that shows it from the front or at most half from the side"
        )
    return fit
