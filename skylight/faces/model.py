"""A linear morphable head: shapes, the 68 iBUG landmarks on them, and smooth local deformation.

Frame: metres, origin mid-head (between the eyes and the ears, at eye height), +Y up, the face looks
along +Z, +X is the person's left, which is right in a picture of the face. Shapes are ::

    vertices = mean + identity_basis a + expression_basis b

with coefficients scaled so that ``a`` less the average face's is standard normal for plausible
adults. The bases come from MakeHuman's CC0 targets (``tools/build_head.py``); which of their faces
is the average one, and where MediaPipe's mesh lies on it, from MediaPipe's canonical face
(``tools/register_face_mesh.py``). NOTICE tells the licences.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cache, cached_property
from importlib.resources import files

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from numpy import ndarray
from scipy.sparse import csr_matrix

from skylight.errors import AssetError


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
        source = files("skylight.faces") / "data" / "head.npz"
        try:
            with source.open("rb") as stream, np.load(stream) as stored:
                step = float(stored["step"])
                vertex_count = len(stored["mean"])
                weights = csr_matrix(
                    (
                        stored["weight_data"].astype(np.float64),
                        stored["weight_indices"].astype(np.int32),
                        stored["weight_indptr"].astype(np.int32),
                    ),
                    shape=(vertex_count, 68),
                )
                arrays = {
                    "mean": stored["mean"].astype(np.float64),
                    "identity_basis": stored["identity"] * step,
                    "expression_basis": stored["expression"] * step,
                    "faces": stored["faces"].astype(np.int64),
                    "regions": stored["regions"],
                    "landmark_faces": stored["landmark_faces"].astype(np.int64),
                    "landmark_bary": stored["landmark_bary"].astype(np.float64),
                    "contour_faces": stored["contour_faces"].astype(np.int64),
                    "contour_bary": stored["contour_bary"].astype(np.float64),
                    "average": stored["average"].astype(np.float64),
                    "mesh_points": stored["mesh_points"].astype(np.int64),
                    "mesh_faces": stored["mesh_faces"].astype(np.int64),
                    "mesh_bary": stored["mesh_bary"].astype(np.float64),
                }
                names = tuple(str(name) for name in stored["expression_names"])
        except (OSError, KeyError, ValueError) as error:
            raise AssetError(
                f"the head model {source} cannot be read ({error}); reinstall skylight"
            ) from error
        for array in arrays.values():
            array.flags.writeable = False  # shared by every caller
        return HeadModel(expression_names=names, weights=weights, **arrays)

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

    def contour(self, vertices: Float[ndarray, "n 3"]) -> Float[ndarray, "17 c 3"]:
        """The jaw landmarks' sliding candidates on a head with these vertices."""
        return np.einsum(
            "lkc,lkcd->lkd", self.contour_bary, vertices[self.faces[self.contour_faces]]
        )

    def landmark_basis(
        self,
    ) -> tuple[Float[ndarray, "68 3"], Float[ndarray, "68 3 k"], Float[ndarray, "68 3 e"]]:
        """Mean, identity and expression basis of the landmarks alone."""
        return self._landmark_basis

    def contour_basis(
        self,
    ) -> tuple[Float[ndarray, "17 c 3"], Float[ndarray, "17 c 3 k"], Float[ndarray, "17 c 3 e"]]:
        """Mean, identity and expression basis of the jaw landmarks' sliding candidates."""
        return self._contour_basis

    def mesh_basis(
        self,
    ) -> tuple[Float[ndarray, "q 3"], Float[ndarray, "q 3 k"], Float[ndarray, "q 3 e"]]:
        """Mean, identity and expression basis of the fitted points of MediaPipe's mesh."""
        return self._mesh_basis

    @cached_property
    def _landmark_basis(self) -> tuple[ndarray, ndarray, ndarray]:
        return self._basis_at(self.landmark_faces, self.landmark_bary)

    @cached_property
    def _mesh_basis(self) -> tuple[ndarray, ndarray, ndarray]:
        return self._basis_at(self.mesh_faces, self.mesh_bary)

    def _basis_at(
        self, faces: Int[ndarray, " n"], bary: Float[ndarray, "n 3"]
    ) -> tuple[ndarray, ndarray, ndarray]:
        corner = self.faces[faces]
        mean, identity, expression = (
            np.einsum("lc,lc...->l...", bary, array[corner])
            for array in (self.mean, self.identity_basis, self.expression_basis)
        )
        return mean, identity, expression

    @cached_property
    def _contour_basis(self) -> tuple[ndarray, ndarray, ndarray]:
        corner = self.faces[self.contour_faces]
        mean, identity, expression = (
            np.einsum("lkc,lkc...->lk...", self.contour_bary, array[corner])
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
