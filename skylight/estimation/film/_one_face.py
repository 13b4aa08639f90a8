"""One person's landmarks from frame to frame.

As MediaPipe does, the landmark network looks where the face was in the frame before; the detector
looks only where it is lost.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from skylight.errors import InputError
from skylight.faces._mediapipe import MediaPipeLandmarker, square_of_landmarks
from skylight.imaging._film import FilmFrame

LEAST_PRESENCE = 0.5
_WEAKEST_SHARE = 0.9  # of the likeliest face's presence
_LOOK_EVERY = 5  # frames, while there is no face: the detector takes five times as long


class OneFace:
    """One person's landmarks from frame to frame: about where they were, else by the detector.

    ``points`` are those of the last frame that had them, and None before; ``number`` is which face
    of the first is followed, 1 the largest. ``notes`` tell of others.
    """

    def __init__(self, landmarker: MediaPipeLandmarker, name: str, number: int = 1) -> None:
        self.landmarker, self.name, self.number = landmarker, name, number
        self.notes: list[str] = []
        self.frames = 0
        self.begin()

    def begin(self, points: Float[ndarray, "478 2"] | None = None) -> None:
        """After a cut, or where the person is known to be."""
        self.points: Float[ndarray, "478 2"] | None = points
        self.without = 0

    def look(self, frame: FilmFrame) -> Float[ndarray, "478 2"] | None:
        """Where the face is, None where it is not seen."""
        self.frames += 1
        found = self._followed(frame) if self.without == 0 else None
        if found is None and self.without % _LOOK_EVERY == 0:
            found = self._detected(frame)
        if found is None:
            self.without += 1
            return None
        self.points, self.without = found, 0
        return found

    def _followed(self, frame: FilmFrame) -> Float[ndarray, "478 2"] | None:
        if self.points is None:
            return None
        points, presence = self.landmarker.glance(frame.codes, square_of_landmarks(self.points))
        return points if presence >= LEAST_PRESENCE else None

    def _detected(self, frame: FilmFrame) -> Float[ndarray, "478 2"] | None:
        found = self._seen(frame)
        if not found and self.frames == 1:  # once, with all the effort that a photograph gets
            found = [face.points for face in self.landmarker.faces(frame.codes)]
        if not found:
            return None
        if self.points is not None:  # whoever is nearest to where the person was
            there = self.points.mean(0)
            return min(found, key=lambda points: float(np.linalg.norm(points.mean(0) - there)))
        if self.number > len(found):
            raise InputError(
                f"{self.name}: there is no face {self.number}, only {len(found)} found at "
                f"{frame.time_s:.1f} s; choose --face 1 to {len(found)}"
            )
        if len(found) > 1:
            which = "the largest" if self.number == 1 else f"number {self.number} by size"
            self.notes.append(
                f"{len(found)} faces at {frame.time_s:.1f} s: {which} is followed; choose by --face"
            )
        return found[self.number - 1]

    def _seen(self, frame: FilmFrame) -> list[Float[ndarray, "478 2"]]:
        """The faces that the detector sees at a glance, the largest first."""
        seen = []
        for square in self.landmarker.find(frame.codes):
            points, _ = self.landmarker.glance(frame.codes, square)
            seen.append(self.landmarker.read(frame.codes, square_of_landmarks(points)))
        # leaves and cloth reach two thirds of a real face's probability
        least = max([LEAST_PRESENCE, *(_WEAKEST_SHARE * one.presence for one in seen)])
        found = [one.points for one in seen if one.presence >= least]
        found.sort(key=lambda points: -float(np.linalg.norm(np.ptp(points, axis=0))))
        return [p for i, p in enumerate(found) if not any(_within(p, q) for q in found[:i])]


def _within(points: Float[ndarray, "478 2"], larger: Float[ndarray, "478 2"]) -> bool:
    """Whether it is a larger face once more."""
    centre = points.mean(0)
    return bool(((centre > larger.min(0)) & (centre < larger.max(0))).all())
