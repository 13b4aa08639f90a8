"""MediaPipe's face landmarker: 478 points of each face.

BlazeFace (Bazarevsky et al. 2019) finds faces in a square of the picture; the landmark network
(Kartynnik et al. 2019, Grishchenko et al. 2020) sees each face in an upright square of its own.
What stands around them, anchors, suppression and squares, follows MediaPipe's graphs
(``mediapipe/tasks/cc/vision/face_landmarker``), with these additions: BlazeFace looks at parts of
the picture too, for small faces, and at it brightened, rotated and continued beyond its borders
where it sees none (:func:`looks`); and the landmark network looks again at the square that its own
landmarks ask for, as MediaPipe does from frame to frame, several times.

BlazeFace was trained on faces that are whole, lit and about upright. A face that fills its picture
is whole where the picture is continued by its mirror image, a dark one is lit where local contrast
is raised (CLAHE, Zuiderveld 1994), and a tilted one stands where the picture is rotated.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from skylight.errors import AssetError
from skylight.faces._blazeface import (
    LEAST_SCORE,
    SIDE,
    Square,
    decode,
    network,
    suppress,
    upright,
    views,
)
from skylight.faces._landmarks import MESH_EYES, DetectedFace, landmark_errors

Picture = UInt8[ndarray, "h w 3"]
Shown = UInt8[ndarray, "h2 w2 3"]

POINTS = 478
# Of looks:
_LOWEST_SCORE = 0.3  # where a face must be sure by its landmarks
_ROTATIONS_DEG = (45.0, -45.0, 90.0, -90.0)
_CLIP_LIMIT, _TILES = 4.0, (4, 4)  # of CLAHE
# Of readings:
_LEAST_PRESENCE, _WEAKEST_SHARE = 0.5, 0.9
_FAINTEST_GLANCE = 0.1  # at BlazeFace's own square
# 14 environment maps without people stay below one or the other, whatever the look
_SURE_PRESENCE, _SURE_SCATTER = 0.9, 0.016
_LEAST_INSIDE = 0.6  # part of the landmarks within the picture; else it is a mirror image's face
# (side, shift of the centre in sides, turn) against the square that the landmarks ask for, and what
# is shown beyond the picture's border: the network leans on it where a face is cut
_GLANCES = (
    (1.0, 0.0, 0.0, cv2.BORDER_REPLICATE),
    (1.08, 0.02, 0.05, cv2.BORDER_CONSTANT),
    (0.94, -0.02, -0.05, cv2.BORDER_REPLICATE),
)
# The one of the 478 points that stands for each of iBUG's 68: of those that MediaPipe's own
# outlines name (face oval, brows, eyes, lips), the one nearest on rendered people.
IBUG = (
    *(162, 127, 93, 132, 172, 136, 149, 148, 152),  # jaw, from the person's right ear to the chin
    *(377, 378, 365, 397, 361, 323, 356, 389),  # and on to the left ear
    *(70, 63, 105, 66, 107, 336, 296, 334, 293, 300),  # brows
    *(168, 197, 5, 4, 240, 97, 2, 326, 460),  # bridge, tip and base of the nose
    *(33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380),  # eyes
    *(61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181),  # lips' outer edge
    *(78, 82, 13, 312, 308, 317, 14, 87),  # and inner edge
)


class MediaPipeLandmarker:
    """Faces by the networks that come with skylight; threads may share it."""

    def __init__(self) -> None:
        self._detector, self._landmarks = network("face_detector"), network("face_landmarks")

    def detect(self, image: UInt8[ndarray, "h w 3"]) -> list[DetectedFace]:
        return [
            DetectedFace(
                points=to_ibug(face.points),
                score=face.presence,
                readings=face.readings,
            )
            for face in self.faces(image)
        ]

    def faces(self, image: UInt8[ndarray, "h w 3"]) -> "list[Reading]":
        """All faces, the largest first.

        Points may lie outside the picture, where a face is cut by its border.
        """
        for look in looks(image):
            if found := self._faces(look):
                return found
        return []

    def _faces(self, look: "Look") -> "list[Reading]":
        height, width = look.picture.shape[:2]
        read: list[Reading] = []
        for square in self.find(look.shown, look.least_score):
            points, presence = self.glance(look.picture, look.in_picture(square))
            if presence < _FAINTEST_GLANCE:
                continue
            seen = self.read(look.picture, square_of_landmarks(points))
            inside = ((seen.points > 0) & (seen.points < [width, height])).all(1).mean()
            if seen.presence < _LEAST_PRESENCE or inside < _LEAST_INSIDE:
                continue
            if seen.sure or not look.last_resort:
                read.append(seen)
        # cloth and leaves reach two thirds of a real face's probability; a lone weak face is kept
        strongest = max((face.presence for face in read), default=0.0)
        read = [face for face in read if face.presence >= _WEAKEST_SHARE * strongest]
        read.sort(key=lambda face: -np.linalg.norm(np.ptp(face.points, axis=0)))
        return [
            face
            for i, face in enumerate(read)
            if not any(_part_of(face.points, larger.points) for larger in read[:i])
        ]

    def find(
        self, image: UInt8[ndarray, "h w 3"], least_score: float = LEAST_SCORE
    ) -> list[Square]:
        """Upright squares around the faces that BlazeFace sees, the surest first."""
        scores, candidates = [], []
        whole, *parts = views(*image.shape[:2])
        for square in (whole, *parts):
            seen = square.cut(image, SIDE, cv2.BORDER_CONSTANT)
            regressors, logits = self._detector.run(seen / np.float32(127.5) - 1)[:2]
            score, found = decode(regressors.reshape(-1, 16), logits.ravel(), least_score)
            # a face that a part of the picture cuts is whole in another
            inside = (square is whole) | ((found[:, :2] > 0) & (found[:, :2] < 1)).all((1, 2))
            scores.append(score[inside])
            candidates.append(square.to_picture(found[inside]))
        return [
            upright(candidate[:2], candidate[2], candidate[3])
            for candidate in suppress(np.concatenate(scores), np.concatenate(candidates))
        ]

    def read(self, image: UInt8[ndarray, "h w 3"], square: Square) -> "Reading":
        """The face in ``square``, read in slightly different squares and their mirror images.

        The mean of six readings scatters a quarter less than one, over lamps that light a still
        face one by one.
        """
        points, presences = [], []
        for scale, shift, turn_rad, border in _GLANCES:
            other = Square(
                centre=square.centre + shift * square.side,
                side=scale * square.side,
                angle_rad=square.angle_rad + turn_rad,
            )
            for mirror in (False, True):
                seen, presence = self.glance(image, other, border, mirror=mirror)
                points.append(seen)
                presences.append(presence)
        return Reading(readings=np.array(points), presence=float(np.mean(presences)))

    def glance(
        self,
        image: UInt8[ndarray, "h w 3"],
        square: Square,
        border: int = cv2.BORDER_REPLICATE,
        *,
        mirror: bool = False,
    ) -> tuple[Float[ndarray, "478 2"], float]:
        """Pixels (x, y) of the 478 points of the face in ``square``; the probability of a face."""
        seen = square.cut(image, self._landmarks.side, border)
        if mirror:
            seen = seen[:, ::-1]
        points, logit = self._landmarks.run(seen / np.float32(255))[:2]
        points = points.reshape(POINTS, 3)[:, :2].astype(np.float64) / self._landmarks.side
        if mirror:
            points = np.array([1, 0]) + points[_mirrored_points()] * [-1, 1]
        return square.to_picture(points), float(1 / (1 + np.exp(-logit.item())))


@dataclass(frozen=True, kw_only=True)
class Reading:
    """Several ``readings`` of one face, pixels (x, y); ``presence``: probability of a face."""

    readings: Float[ndarray, "r 478 2"]
    presence: float

    @property
    def points(self) -> Float[ndarray, "478 2"]:
        """Their mean."""
        return self.readings.mean(0)

    @property
    def scatter(self) -> float:
        """The points' median distance from their mean, over the face's extent."""
        apart = np.median(np.linalg.norm(self.readings - self.points, axis=2))
        return float(apart / np.ptp(self.points, axis=0).max())

    @property
    def sure(self) -> bool:
        """Whether it is a face beyond what a wall or a cave reaches now and then."""
        return self.presence >= _SURE_PRESENCE and self.scatter < _SURE_SCATTER


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
        for degrees in _ROTATIONS_DEG:
            shown, back = rotated(picture, degrees)
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


def rotated(image: Picture, angle_deg: float) -> tuple[Shown, Float[ndarray, "2 3"]]:
    """(the whole picture rotated clockwise as it is seen, black around it; the way back)."""
    angle = np.radians(angle_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    source = np.array(image.shape[1::-1], dtype=np.float64)
    size = np.ceil(np.abs(turn) @ source - 1e-6).astype(int)
    back = np.column_stack([turn.T, source / 2 - turn.T @ (size / 2)])
    centres = back.copy()  # OpenCV's integers name pixel centres
    centres[:, 2] += back[:, :2] @ [0.5, 0.5] - 0.5
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(image, centres, (int(size[0]), int(size[1])), flags=flags), back


def square_of_landmarks(points: Float[ndarray, "478 2"]) -> Square:
    """Where the landmark network looks for the face that has, or had, these landmarks."""
    box = np.stack([points.min(0), points.max(0)])
    right, left = MESH_EYES
    return upright(box, points[right], points[left])


def _part_of(points: Float[ndarray, "478 2"], larger: Float[ndarray, "478 2"]) -> bool:
    """Whether what was read is a larger face once more, or an eye or mouth taken for a face."""
    centre = points.mean(0)
    return bool(((centre > larger.min(0)) & (centre < larger.max(0))).all())


def to_ibug(points: Float[ndarray, "478 2"]) -> Float[ndarray, "68 2"]:
    """iBUG's landmarks from the 478: the nearest points, less their mean error on rendered people.

    MediaPipe's points and iBUG's are not defined alike, so part of the distance between them is
    always the same, seen along and across the line of the eyes.
    """
    return points[list(IBUG)] - _mean_errors() @ eye_axes(points)


def eye_axes(points: Float[ndarray, "478 2"]) -> Float[ndarray, "2 2"]:
    """Rows: from the right eye's outer corner to the left's, and as far at right angles down."""
    right, left = MESH_EYES
    x, y = points[left] - points[right]
    return np.array([[x, y], [-y, x]])


@cache
def _mirrored_points() -> Int[ndarray, "478"]:
    """Which point of a mirror image is which (``tools/build_mirrored_points.py``)."""
    source = files("skylight.faces") / "data" / "mirrored_points.npy"
    try:
        with source.open("rb") as stream:
            return np.load(stream).astype(np.int64)
    except (OSError, ValueError, EOFError) as error:
        raise AssetError(f"{source} cannot be read ({error}); reinstall skylight") from error


@cache
def _mean_errors() -> Float[ndarray, "68 2"]:
    """In units of :func:`eye_axes`."""
    return landmark_errors("mediapipe", "mean_error")[0]
