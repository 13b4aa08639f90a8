"""Detected points and where they are on the head: what a fit compares.

Two kinds, each with the measured second moment S of its errors
(``tools/measure_landmarks.py``): errors go together along jaw, brows and with the light, and points
treated as independent would turn that into errors of pose.
"""

from functools import cache
from importlib.resources import files
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from skylight.errors import AssetError
from skylight.faces.landmarks import DetectedFace
from skylight.faces.model import HeadModel

Basis = tuple[ndarray, ndarray, ndarray]  # mean (n,3), identity (n,3,k), expression (n,3,e)
_JAW = np.arange(17)
_EYES: tuple[int, int] = (36, 45)  # outer corners, the person's right first: iBUG's
_MESH_EYES: tuple[int, int] = (33, 263)  # and MediaPipe's


@runtime_checkable
class Correspondence(Protocol):
    """``target`` (n,2) pixels; ``whiten`` is W with W^T W = S^-1, S in squared pixels.

    ``eyes`` are the rows of the eyes' outer corners, the person's right first.
    """

    target: ndarray
    whiten: ndarray
    basis: Basis
    eyes: tuple[int, int]

    def points(
        self,
        rotation: Float[ndarray, "3 3"],
        translation: Float[ndarray, "3"],
        identity: Float[ndarray, " k"],
        expression: Float[ndarray, " e"],
    ) -> tuple[Float[ndarray, "n 3"], Float[ndarray, "n 3 p"]]:
        """The points of that head in its own frame, and their d/d(identity, expression)."""
        ...


def correspondence(model: HeadModel, face: DetectedFace) -> Correspondence:
    """MediaPipe's mesh where the face has readings of it, else the 68 landmarks."""
    if face.readings is None:
        return SlidingLandmarks(model, face.points)
    return MeshPoints(model, face.readings)


class MeshPoints:
    """Every second point of MediaPipe's mesh, fixed on the head; the irises, which turn, left out.

    The readings' covariance C is added to S, its diagonal twice: a point in the dark, behind a hand
    or beyond the border moves from one reading to the next, and so loses weight. C is not divided
    by their number, since readings share most errors.
    """

    def __init__(self, model: HeadModel, readings: Float[ndarray, "r 478 2"]) -> None:
        mean = readings.mean(0)
        right, left = _MESH_EYES
        eye_distance = float(np.linalg.norm(mean[left] - mean[right]))
        self.basis = model.mesh_basis()
        self.target = mean[model.mesh_points]
        rows = [int(np.flatnonzero(model.mesh_points == point)[0]) for point in _MESH_EYES]
        self.eyes = rows[0], rows[1]
        apart = (readings - mean)[:, model.mesh_points].reshape(len(readings), -1) / eye_distance
        own = apart.T @ apart / max(len(readings) - 1, 1)
        moment = _mesh_moment() + own + np.diag(np.diag(own))
        self.whiten = np.linalg.inv(np.linalg.cholesky(moment)) / eye_distance

    def points(
        self,
        rotation: Float[ndarray, "3 3"],
        translation: Float[ndarray, "3"],
        identity: Float[ndarray, " k"],
        expression: Float[ndarray, " e"],
    ) -> tuple[Float[ndarray, "n 3"], Float[ndarray, "n 3 p"]]:
        mean, by_identity, by_expression = self.basis
        points = mean + by_identity @ identity + by_expression @ expression
        return points, np.concatenate([by_identity, by_expression], 2)


class SlidingLandmarks:
    """iBUG's 68 landmarks, see :func:`slid_landmarks`."""

    def __init__(self, model: HeadModel, target: Float[ndarray, "68 2"]) -> None:
        self._model = model
        self.target, self.eyes = target, _EYES
        self.basis = model.landmark_basis()
        right, left = _EYES
        self.whiten = _whitening() / float(np.linalg.norm(target[left] - target[right]))

    def points(
        self,
        rotation: Float[ndarray, "3 3"],
        translation: Float[ndarray, "3"],
        identity: Float[ndarray, " k"],
        expression: Float[ndarray, " e"],
    ) -> tuple[Float[ndarray, "68 3"], Float[ndarray, "68 3 p"]]:
        return slid_landmarks(self._model, rotation, translation, identity, expression)


def slid_landmarks(
    model: HeadModel,
    rotation: Float[ndarray, "3 3"],
    translation: Float[ndarray, "3"],
    identity: Float[ndarray, " k"],
    expression: Float[ndarray, " e"],
) -> tuple[Float[ndarray, "68 3"], Float[ndarray, "68 3 p"]]:
    """iBUG's landmarks in the head's frame, and their d/d(identity, expression).

    51 are fixed on the head; the jaw's 17 slide along it to the silhouette that a camera at the
    origin sees.
    """
    mean, by_identity, by_expression = model.landmark_basis()
    points = mean + by_identity @ identity + by_expression @ expression
    jacobian = np.concatenate([by_identity, by_expression], 2)
    mean, by_identity, by_expression = model.contour_basis()
    candidates = mean + by_identity @ identity + by_expression @ expression
    # of each row of the jaw the candidate that lies outermost in the picture
    image = _pinhole(candidates @ rotation.T + translation)
    outward = image[:, 0] - _pinhole(points[27:36] @ rotation.T + translation).mean(0)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    chosen = np.einsum("rcd,rd->rc", image, outward).argmax(1)
    points[_JAW] = candidates[_JAW, chosen]
    jacobian[_JAW] = np.concatenate([by_identity[_JAW, chosen], by_expression[_JAW, chosen]], 2)
    return points, jacobian


def _pinhole(points: Float[ndarray, "*s 3"]) -> Float[ndarray, "*s 2"]:
    """Picture coordinates of focal length 1."""
    return points[..., :2] * [1, -1] / -points[..., 2:]


@cache
def _mesh_moment() -> Float[ndarray, "q q"]:
    """S = U U^T + diag(own) of the mesh's points, in squared eye distances."""
    source = files("skylight.faces") / "data" / "mediapipe_landmarks.npz"
    try:
        with source.open("rb") as stream, np.load(stream) as stored:
            modes = stored["modes"].astype(np.float64)
            return modes @ modes.T + np.diag(stored["own"].astype(np.float64))
    except (OSError, KeyError, ValueError) as error:
        raise AssetError(
            f"{source}: the landmark errors cannot be read ({error}); reinstall skylight"
        ) from error


@cache
def _whitening() -> Float[ndarray, "136 136"]:
    """Of the 68 landmarks, in eye distances."""
    source = files("skylight.faces") / "data" / "dlib_landmarks.npz"
    try:
        with source.open("rb") as stream, np.load(stream) as stored:
            moment = stored["second_moment"].astype(np.float64)
        return np.linalg.cholesky(np.linalg.inv(moment)).T
    except (OSError, KeyError, ValueError, np.linalg.LinAlgError) as error:
        raise AssetError(
            f"{source}: the landmark errors cannot be read ({error}); reinstall skylight"
        ) from error
