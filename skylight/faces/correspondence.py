"""Detected points and where they are on the head: what a fit compares.

Two kinds, each with the measured second moment S of its errors
(``tools/measure_landmarks.py``): errors go together along jaw, brows and with the light, and points
treated as independent would turn that into errors of pose.
"""

from functools import cache
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from skylight.faces.landmarks import EYES, MESH_EYES, DetectedFace, landmark_errors
from skylight.faces.model import HeadModel

Basis = tuple[ndarray, ndarray, ndarray]  # mean (n,3), identity (n,3,k), expression (n,3,e)
JAW = np.arange(17)


@runtime_checkable
class PosedHead(Protocol):
    """Shape and place of a head: R X(identity, expression) + t is in the camera's frame."""

    @property
    def rotation(self) -> Float[ndarray, "3 3"]: ...

    @property
    def translation(self) -> Float[ndarray, "3"]: ...

    @property
    def identity(self) -> Float[ndarray, " k"]: ...

    @property
    def expression(self) -> Float[ndarray, " e"]: ...


@runtime_checkable
class Correspondence(Protocol):
    """``target`` (n,2) pixels; ``whiten`` is W with W^T W = S^-1, S in squared pixels.

    ``eyes`` are the rows of the eyes' outer corners, the person's right first.
    """

    target: ndarray
    whiten: ndarray
    basis: Basis
    eyes: tuple[int, int]

    def points(self, head: PosedHead) -> tuple[Float[ndarray, "n 3"], Float[ndarray, "n 3 p"]]:
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
        right, left = MESH_EYES
        eye_distance = float(np.linalg.norm(mean[left] - mean[right]))
        self.basis = model.mesh_basis()
        self.target = mean[model.mesh_points]
        rows = [int(np.flatnonzero(model.mesh_points == point)[0]) for point in MESH_EYES]
        self.eyes = rows[0], rows[1]
        apart = (readings - mean)[:, model.mesh_points].reshape(len(readings), -1) / eye_distance
        own = apart.T @ apart / max(len(readings) - 1, 1)
        moment = _mesh_moment() + own + np.diag(np.diag(own))
        self.whiten = np.linalg.inv(np.linalg.cholesky(moment)) / eye_distance

    def points(self, head: PosedHead) -> tuple[Float[ndarray, "n 3"], Float[ndarray, "n 3 p"]]:
        return _shaped(self.basis, head), np.concatenate(self.basis[1:], 2)


class SlidingLandmarks:
    """iBUG's 68 landmarks, see :func:`slid_landmarks`."""

    def __init__(self, model: HeadModel, target: Float[ndarray, "68 2"]) -> None:
        self._model = model
        self.target, self.eyes = target, EYES
        self.basis = model.landmark_basis()
        right, left = EYES
        self.whiten = _whitening() / float(np.linalg.norm(target[left] - target[right]))

    def points(self, head: PosedHead) -> tuple[Float[ndarray, "68 3"], Float[ndarray, "68 3 p"]]:
        return slid_landmarks(self._model, head)


def slid_landmarks(
    model: HeadModel, head: PosedHead
) -> tuple[Float[ndarray, "68 3"], Float[ndarray, "68 3 p"]]:
    """iBUG's landmarks in the head's frame, and their d/d(identity, expression).

    51 are fixed on the head; the jaw's 17 slide along it to the silhouette that a camera at the
    origin sees.
    """
    fixed, sliding = model.landmark_basis(), model.contour_basis()
    points, candidates = _shaped(fixed, head), _shaped(sliding, head)
    # of each row of the jaw the candidate that lies outermost in the picture
    image = _pinhole(candidates @ head.rotation.T + head.translation)
    outward = image[:, 0] - _pinhole(points[27:36] @ head.rotation.T + head.translation).mean(0)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    chosen = np.einsum("rcd,rd->rc", image, outward).argmax(1)
    jacobian = np.concatenate(fixed[1:], 2)
    points[JAW] = candidates[JAW, chosen]
    jacobian[JAW] = np.concatenate([part[JAW, chosen] for part in sliding[1:]], 2)
    return points, jacobian


def _shaped(basis: Basis, head: PosedHead) -> Float[ndarray, "*s 3"]:
    """Points of a basis on that head, in its own frame."""
    mean, by_identity, by_expression = basis
    return mean + by_identity @ head.identity + by_expression @ head.expression


def _pinhole(points: Float[ndarray, "*s 3"]) -> Float[ndarray, "*s 2"]:
    """Picture coordinates of focal length 1."""
    return points[..., :2] * [1, -1] / -points[..., 2:]


@cache
def _mesh_moment() -> Float[ndarray, "q q"]:
    """S = U U^T + diag(own) of the mesh's points, in squared eye distances."""
    errors = landmark_errors("mediapipe")
    return errors["modes"] @ errors["modes"].T + np.diag(errors["own"])


@cache
def _whitening() -> Float[ndarray, "136 136"]:
    """Of the 68 landmarks, in eye distances."""
    return np.linalg.cholesky(np.linalg.inv(landmark_errors("dlib")["second_moment"])).T
