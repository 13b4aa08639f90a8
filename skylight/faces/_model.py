"""A linear morphable head: shapes, the 68 iBUG landmarks on them, and smooth local deformation.

Frame: metres, origin mid-head (between the eyes and the ears, at eye height), +Y up, the face looks
along +Z, +X is the person's left, which is right in a picture of the face. Shapes are ::

    vertices = mean + identity_basis a + expression_basis b

with coefficients scaled so that ``a`` less the average face's is standard normal for plausible
adults. The bases come from MakeHuman's CC0 targets (``tools/build_head.py``); which of their faces
is the average one, and where MediaPipe's mesh lies on it, from MediaPipe's canonical face
(``tools/register_face_mesh.py``). NOTICE has the licences.

A fit compares detected points with where they are on the head (:class:`Correspondence`). There are
two kinds, each with the measured second moment S of its errors (``tools/measure_landmarks.py``):
errors go together along jaw, brows and with the light, and points treated as independent would
become errors of pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cache, cached_property
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from numpy import ndarray
from scipy.sparse import csr_matrix

from skylight.faces._landmarks import EYES, MESH_EYES, DetectedFace, landmark_errors, shipped_arrays

# Mean (n,3), identity basis (n,3,k) and expression basis (n,3,e) of some points of the head.
Basis = tuple[ndarray, ndarray, ndarray]
JAW = np.arange(17)
_REALS = ("mean", "landmark_bary", "contour_bary", "average", "mesh_bary")
_INDICES = ("faces", "landmark_faces", "contour_faces", "mesh_points", "mesh_faces")
_WEIGHTS = ("weight_data", "weight_indices", "weight_indptr")
_OTHERS = ("step", "identity", "expression", "regions", "expression_names")


class Region(IntEnum):
    """What a vertex belongs to."""

    FACE = 0  # bare skin to read light off: hairline to chin, in front of the ears
    EYEBALL = 1
    MOUTH = 2  # inside of the mouth, teeth, the hidden part of the lips
    BROW = 3
    SCALP = 4  # where hair would be, temples and nape included
    EAR = 5
    NECK = 6  # under the jaw line
    LIPS = 7
    HIDDEN = 8  # nostrils, lid margins and eye sockets: skin in a hole


@dataclass(frozen=True, kw_only=True)
class HeadModel:
    """The head model: n vertices, f triangles, k identity and e expression coefficients."""

    mean: Float[ndarray, "n 3"]
    identity_basis: Float[ndarray, "n 3 k"]
    expression_basis: Float[ndarray, "n 3 e"]
    expression_names: tuple[str, ...]
    faces: Int[ndarray, "f 3"]  # counter-clockwise seen from outside
    regions: UInt8[ndarray, " n"]  # values of Region
    landmark_faces: Int[ndarray, " 68"]  # triangle that each landmark lies in,
    landmark_bary: Float[ndarray, "68 3"]  # and where
    # Points that the jaw landmarks 0..16 slide over as the head turns, each row ordered from the
    # face to the back: the landmark seen is about the one outermost in the picture.
    contour_faces: Int[ndarray, "17 c"]
    contour_bary: Float[ndarray, "17 c 3"]
    average: Float[ndarray, " k"]  # identity of the average face
    # Of MediaPipe's 478 points those that are fitted, and where they lie.
    mesh_points: Int[ndarray, " q"]
    mesh_faces: Int[ndarray, " q"]
    mesh_bary: Float[ndarray, "q 3"]
    # Bounded biharmonic weights of the landmarks (n, 68); what a row lacks to one holds still.
    weights: csr_matrix

    @staticmethod
    @cache
    def load() -> HeadModel:
        """The head model shipped with the package, float64; read once."""
        names = (*_REALS, *_INDICES, *_WEIGHTS, *_OTHERS)
        stored = shipped_arrays("skylight.faces", "head.npz", *names)
        data, indices, starts = (stored[name] for name in _WEIGHTS)
        weights = csr_matrix(
            (data.astype(np.float64), indices.astype(np.int32), starts.astype(np.int32)),
            shape=(len(stored["mean"]), 68),
        )
        step = float(stored["step"])
        arrays = {
            "identity_basis": stored["identity"] * step,
            "expression_basis": stored["expression"] * step,
            "regions": stored["regions"],
            **{name: stored[name].astype(np.float64) for name in _REALS},
            **{name: stored[name].astype(np.int64) for name in _INDICES},
        }
        for array in arrays.values():
            array.flags.writeable = False  # shared by every caller
        expressions = tuple(map(str, stored["expression_names"]))
        return HeadModel(expression_names=expressions, weights=weights, **arrays)

    def vertices(
        self, identity: Float[ndarray, " k"], expression: Float[ndarray, " e"]
    ) -> Float[ndarray, "n 3"]:
        """Vertex positions, metres."""
        return self.mean + self.identity_basis @ identity + self.expression_basis @ expression

    def landmarks(self, vertices: Float[ndarray, "n 3"]) -> Float[ndarray, "68 3"]:
        """The iBUG landmarks (dlib's order) of a head with these vertices."""
        return np.einsum(
            "lc,lcd->ld", self.landmark_bary, vertices[self.faces[self.landmark_faces]]
        )

    @cached_property
    def landmark_basis(self) -> Basis:
        """Of the 68 landmarks alone."""
        return self._basis_at(self.landmark_faces, self.landmark_bary)

    @cached_property
    def contour_basis(self) -> Basis:
        """Of the jaw landmarks' sliding candidates, (17,c) of them."""
        mean, identity, expression = self._basis_at(
            self.contour_faces.ravel(), self.contour_bary.reshape(-1, 3)
        )
        rows = self.contour_faces.shape
        return (
            mean.reshape(*rows, 3),
            identity.reshape(*rows, 3, -1),
            expression.reshape(*rows, 3, -1),
        )

    @cached_property
    def mesh_basis(self) -> Basis:
        """Of the fitted points of MediaPipe's mesh."""
        return self._basis_at(self.mesh_faces, self.mesh_bary)

    def _basis_at(self, faces: Int[ndarray, " l"], bary: Float[ndarray, "l 3"]) -> Basis:
        corner = self.faces[faces]
        mean, identity, expression = (
            np.einsum("lc,lc...->l...", bary, array[corner])
            for array in (self.mean, self.identity_basis, self.expression_basis)
        )
        return mean, identity, expression

    def deform(
        self, vertices: Float[ndarray, "n 3"], displacements: Float[ndarray, "68 3"]
    ) -> Float[ndarray, "n 3"]:
        """Move the landmarks by ``displacements`` (metres) and the skin between them smoothly.

        Bounded biharmonic weights (Jacobson et al. 2011) of the mean head. Each landmark moves by
        exactly its displacement; skin further than 45 mm from all of them keeps still.
        """
        return vertices + self.weights @ displacements

    def sample(
        self, generator: np.random.Generator | torch.Generator
    ) -> tuple[Float[ndarray, " k"], Float[ndarray, " e"]]:
        """Coefficients of a random plausible person.

        Identity is standard normal about the average face. Expression units only contract, so
        theirs are half-normal with most of them idle (each is active with probability 0.3); the two
        sides of the face mostly act together, and a face is quiet or lively as a whole.
        """
        if isinstance(generator, torch.Generator):
            seed = torch.randint(2**62, (), generator=generator, dtype=torch.int64)
            generator = np.random.default_rng(int(seed))
        identity = self.average + generator.standard_normal(len(self.average))
        pairs = [name.replace("-left-", "-right-") for name in self.expression_names]
        units = sorted(set(pairs))
        active = generator.random(len(units)) < 0.3
        strength = dict(
            zip(units, active * np.abs(generator.standard_normal(len(units))), strict=True)
        )
        liveliness = generator.random()
        side = 1 + 0.2 * generator.standard_normal(len(pairs)).clip(-2, 2)
        expression = liveliness * side * np.array([strength[pair] for pair in pairs])
        return identity, expression


@runtime_checkable
class PosedHead(Protocol):
    """Shape and place of a head: R X(identity, expression) + t is in the camera's frame."""

    @property
    def rotation(self) -> Float[ndarray, "3 3"]: ...

    @property
    def translation(self) -> Float[ndarray, 3]: ...

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
        self.basis = model.mesh_basis
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
        self.basis = model.landmark_basis
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
    fixed, sliding = model.landmark_basis, model.contour_basis
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
    modes, own = landmark_errors("mediapipe", "modes", "own")
    return modes @ modes.T + np.diag(own)


@cache
def mesh_whitening() -> Float[ndarray, "q q"]:
    """Of the mesh's points, in eye distances: W with W^T W = S^-1."""
    return np.linalg.inv(np.linalg.cholesky(_mesh_moment()))


@cache
def _whitening() -> Float[ndarray, "136 136"]:
    """Of the 68 landmarks, in eye distances."""
    (moment,) = landmark_errors("dlib", "second_moment")
    return np.linalg.cholesky(np.linalg.inv(moment)).T
