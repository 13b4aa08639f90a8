"""A face followed from frame to frame as they come, and the colours of its skin."""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray

from skylight.faces._landmarks import DetectedFace
from skylight.faces._mediapipe import MediaPipeLandmarker, square_of_landmarks, to_ibug
from skylight.faces._model import HeadModel
from skylight.imaging._colour import Decode, decode_values
from skylight.live._head import LiveHead

LEAST_PRESENCE = 0.5  # of the landmark network, as in films
LOOK_EVERY = 5  # frames, while there is no face: the detector takes several times as long
FACE_HEIGHT_PX = 48  # to which the face is averaged before colours are read: 3 mm a pixel
# What is left out: skin that the camera sees at more than 75 degrees, and over-exposed pixels
GRAZING_COSINE, CLIPPED = 0.25, 0.97
FEWEST_POINTS = 60


@dataclass(frozen=True, kw_only=True)
class SeenSkin:
    """``colours`` (p,3) of a head's points, linear, that count ``weights`` (p,)."""

    colours: Float[ndarray, "p 3"]
    weights: Float[ndarray, " p"]


class FaceFollower:
    """The largest face, by the landmark network about where it was; else by the detector."""

    def __init__(self, decode: Decode = "srgb") -> None:
        self._landmarker = MediaPipeLandmarker()
        self._decode = decode
        self._points: Float[ndarray, "478 2"] | None = None
        self._without = 0
        self.head: LiveHead | None = None

    def follow(self, codes: UInt8[ndarray, "h w 3"]) -> bool:
        """Whether the face is seen in this frame: then ``head`` is posed as there.

        A face that is found anew gets a head of its own, which takes a third of a second.
        """
        height, width = codes.shape[:2]
        if self.head is not None and self.head.size != (width, height):
            self._points = self.head = None
        if self._points is not None and self.head is not None:
            square = square_of_landmarks(self._points)
            points, presence = self._landmarker.glance(codes, square)
            if presence >= LEAST_PRESENCE and self.head.follow(points):
                self._points = points
                return True
            self._points, self._without = None, 0
        self._without += 1
        return (self._without - 1) % LOOK_EVERY == 0 and self._find(codes)

    def _find(self, codes: UInt8[ndarray, "h w 3"]) -> bool:
        height, width = codes.shape[:2]
        found = [
            self._landmarker.read(
                codes, square_of_landmarks(self._landmarker.glance(codes, one)[0])
            )
            for one in self._landmarker.find(codes)
        ]
        found = [one for one in found if one.presence >= LEAST_PRESENCE]
        if not found:
            return False
        face = max(found, key=lambda one: float(np.ptp(one.points, axis=0).max()))
        detected = DetectedFace(
            points=to_ibug(face.points), score=face.presence, readings=face.readings
        )
        self.head = LiveHead(HeadModel.load(), detected, width, height)
        self._points = face.points
        return True

    def skin(self, codes: UInt8[ndarray, "h w 3"]) -> SeenSkin | None:
        """Colours of the head's points in the frame that was followed last; None of too few."""
        assert self.head is not None
        positions, places = self.head.places()
        height, width = codes.shape[:2]
        inside = ((places > 0) & (places < [width, height])).all(1)
        if not inside.any():
            return None
        low = np.floor(places[inside].min(0)).astype(int)
        high = np.ceil(places[inside].max(0)).astype(int)
        part = codes[low[1] : high[1], low[0] : high[0]]
        linear = _table(self._decode)[part]
        scale = min(1.0, FACE_HEIGHT_PX / len(part))
        size = max(1, round(part.shape[1] * scale)), max(1, round(part.shape[0] * scale))
        small = cv2.resize(linear, size, interpolation=cv2.INTER_AREA)
        ratio = np.array(size) / [part.shape[1], part.shape[0]]
        at = ((places - low) * ratio - 0.5).astype(np.float32)  # OpenCV's integers are centres
        read = cv2.remap(
            small, at[:, :1], at[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        colours = read[:, 0].astype(np.float64)
        facing = self._facing(positions)
        usable = inside & (facing > GRAZING_COSINE) & (colours.max(1) < CLIPPED)
        if usable.sum() < FEWEST_POINTS or not colours[usable].any():
            return None
        return SeenSkin(colours=colours, weights=np.where(usable, facing, 0.0))

    def _facing(self, positions: Float[ndarray, "p 3"]) -> Float[ndarray, " p"]:
        """Cosines at which the camera sees the points, 0 of those that the head hides.

        Hidden is what does not see the head's direction to the camera: as from far away, which
        from half a metre is another by up to 7 degrees.
        """
        assert self.head is not None
        skin, rotation = self.head.skin, self.head.state.rotation
        towards = -positions / np.linalg.norm(positions, axis=1, keepdims=True)
        facing = ((skin.normals @ rotation.T) * towards).sum(1)
        camera = rotation.T @ towards.mean(0)
        nearest = int((skin.grid.directions.numpy() @ camera).argmax())
        return np.where(skin.transport[:, nearest] > 0, facing, 0.0)


@cache
def _table(decode: Decode) -> Float[ndarray, "256"]:
    """Linear values of 8-bit codes."""
    return decode_values(torch.arange(256) / 255, decode).numpy()
