"""MediaPipe's networks, run by onnxruntime, and what stands around BlazeFace, the detector.

``tools/convert_networks.py`` made the files of the networks. Anchors, decoding and suppression of
BlazeFace (Bazarevsky et al. 2019) have the numbers of
``mediapipe/tasks/cc/vision/face_detector/face_detector_graph.cc``.
"""

import math
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import cv2
import numpy as np
from jaxtyping import Float, Float32, Real
from numpy import ndarray

from skylight.errors import AssetError

SIDE = 128  # of its pictures
LEAST_SCORE = 0.5  # of a face in the picture itself
_MOST_OVERLAP = 0.3
_MARGIN = 1.5  # the landmark network's square over the face's box


@dataclass(frozen=True, kw_only=True)
class Square:
    """A rotated square of a picture: centre and side in pixels; its right is (cos a, sin a)."""

    centre: Float[ndarray, "2"]
    side: float
    angle_rad: float

    @property
    def axes(self) -> Float[ndarray, "2 2"]:
        """Its right and down, as columns, in pixels."""
        c, s = np.cos(self.angle_rad), np.sin(self.angle_rad)
        return self.side * np.array([[c, -s], [s, c]])

    def to_picture(self, points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Pixels (pixel centres at +0.5) of points in it, which count from 0 to 1."""
        return self.centre + (points - 0.5) @ self.axes.T

    def cut(
        self, image: Real[ndarray, "h w 3"], side: int, border: int
    ) -> Real[ndarray, "{side} {side} 3"]:
        """What it shows of a picture, ``side`` pixels a side; ``border`` is one of OpenCV's."""
        finer = max(1, round(self.side / side))  # then averaged: bilinear samples alone alias
        step = self.axes / (side * finer)
        first = self.to_picture(np.zeros(2)) + step @ [0.5, 0.5] - 0.5  # OpenCV names centres
        matrix = np.column_stack([step, first])
        size = (side * finer, side * finer)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        shown = cv2.warpAffine(image, matrix, size, flags=flags, borderMode=border)
        return cv2.resize(shown, (side, side), interpolation=cv2.INTER_AREA)

    def paste(
        self, shown: Float32[ndarray, "side side"], height: int, width: int
    ) -> Float32[ndarray, "{height} {width}"]:
        """A picture of 0 but for what the square shows, as :meth:`cut` cuts it out."""
        step = self.axes / len(shown)
        first = self.to_picture(np.zeros(2)) + step @ [0.5, 0.5] - 0.5
        matrix = np.column_stack([step, first])
        return cv2.warpAffine(shown, matrix, (width, height), flags=cv2.INTER_LINEAR)


def upright(
    box: Float[ndarray, "2 2"], right_eye: Float[ndarray, "2"], left_eye: Float[ndarray, "2"]
) -> Square:
    """The square around a face's box, rotated so that the eyes are level in it."""
    x, y = left_eye - right_eye
    return Square(
        centre=box.mean(0),
        side=float(_MARGIN * (box[1] - box[0]).max()),
        angle_rad=float(np.arctan2(y, x)),
    )


@cache
def _anchors() -> Float[ndarray, "896 2"]:
    """Centres (x, y) of BlazeFace's anchors, from 0 to 1: 2 in each of 16^2 cells, 6 in 8^2."""
    grids = []
    for cells, each in ((16, 2), (8, 6)):
        y, x = (np.indices((cells, cells)).reshape(2, -1) + 0.5) / cells
        grids.append(np.repeat(np.stack([x, y], 1), each, axis=0))
    return np.concatenate(grids)


def decode(
    regressors: Float[ndarray, "896 16"],
    logits: Float[ndarray, "896"],
    least_score: float = LEAST_SCORE,
) -> tuple[Float[ndarray, " n"], Float[ndarray, "n 8 2"]]:
    """(scores, candidates) of what may be faces, each as 8 points (x, y) from 0 to 1.

    They are the box's first and last corner, the eyes (the person's right, then left), nose,
    mouth and ears. Regressors hold the box's centre and size and the 6 points, in 1/128 of the
    view and, sizes apart, from the anchor on.
    """
    score = 1 / (1 + np.exp(-logits.astype(np.float64).clip(-100, 100)))
    sure = score >= least_score
    raw = regressors[sure].astype(np.float64).reshape(-1, 8, 2) / SIDE
    points = raw + _anchors()[sure][:, None]
    half = raw[:, 1] / 2
    return score[sure], np.concatenate(
        [(points[:, 0] - half)[:, None], (points[:, 0] + half)[:, None], points[:, 2:]], 1
    )


def suppress(
    scores: Float[ndarray, " n"], candidates: Float[ndarray, "n 8 2"]
) -> list[Float[ndarray, "8 2"]]:
    """One candidate a face, the surest first: the mean, by score, of those that overlap."""
    order = np.argsort(-scores)
    scores, candidates = scores[order], candidates[order]
    merged = []
    while len(scores):
        same = overlap(candidates[0, :2], candidates[:, :2]) > _MOST_OVERLAP
        same[0] = True  # even where its box is empty
        merged.append(np.average(candidates[same], axis=0, weights=scores[same]))
        scores, candidates = scores[~same], candidates[~same]
    return merged


def overlap(box: Float[ndarray, "2 2"], boxes: Float[ndarray, "n 2 2"]) -> Float[ndarray, " n"]:
    """Area of the intersection over the union's; boxes as first and last corner."""
    common = np.minimum(box[1], boxes[:, 1]) - np.maximum(box[0], boxes[:, 0])
    shared = common.clip(0).prod(1)
    areas = (boxes[:, 1] - boxes[:, 0]).prod(1)
    return shared / np.maximum(np.prod(box[1] - box[0]) + areas - shared, 1e-12)


def views(height: int, width: int) -> list[Square]:
    """Where BlazeFace looks: the whole picture, then parts of a half and a quarter of its side.

    Parts overlap by half, and none is smaller than what BlazeFace takes: it would show no more.
    """
    long = max(height, width)
    whole = Square(centre=np.array([width / 2, height / 2]), side=float(long), angle_rad=0.0)
    looks = [whole]
    for side in (long / 2, long / 4):
        if side >= SIDE:
            x, y = (_middles(length, side) for length in (width, height))
            centres = np.stack(np.meshgrid(x, y), 2).reshape(-1, 2)
            looks += [Square(centre=centre, side=side, angle_rad=0.0) for centre in centres]
    return looks


def _middles(length: int, side: float) -> Float[ndarray, " n"]:
    """Of stretches ``side`` long that cover ``length``, each half over the next."""
    if length <= side:
        return np.array([length / 2])
    return np.linspace(side / 2, length - side / 2, math.ceil(2 * (length - side) / side) + 1)


class Network:
    """A network of this package that takes one picture; threads may share it."""

    def __init__(self, name: str) -> None:
        import onnxruntime  # where it is used only: imported, it leaves a file in TMPDIR

        source = files("skylight.faces") / "data" / f"{name}.onnx"
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 4  # errors are raised: no second message
        options.intra_op_num_threads = 1  # a face is work for one core
        try:
            self._session = onnxruntime.InferenceSession(
                source.read_bytes(), options, providers=["CPUExecutionProvider"]
            )
        # onnxruntime raises classes of its own, whose base is Exception
        except Exception as error:
            first = str(error).partition("\n")[0]
            raise AssetError(f"{source} cannot be read ({first}); reinstall skylight") from error
        (self._input,) = self._session.get_inputs()

    @property
    def side(self) -> int:
        """Rows and columns of the picture."""
        return self._input.shape[1]

    def run(self, picture: Float32[ndarray, "s s c"]) -> list[ndarray]:
        """All outputs for one picture of as many channels as it takes, in the model's order."""
        outputs = self._session.run(None, {self._input.name: picture[None]})
        return [np.asarray(output) for output in outputs]


@cache
def network(name: str) -> Network:
    """``face_detector``, ``face_landmarks`` or ``hair_segmenter``, loaded once a process."""
    return Network(name)
