"""Rigid transforms: rotations and translations, SE(3)."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Float
from kornia.geometry.conversions import (
    axis_angle_to_rotation_matrix,
    rotation_matrix_to_axis_angle,
)
from torch import Tensor

from skylight.errors import InputError

_TOLERANCE = 1e-6  # of float64; numbers of single precision are a hundred times coarser

# rows of a tensor or, for OpenCV, of an array; results are of the same kind
Vectors = TypeVar("Vectors", Float[Tensor, "*_ 3"], Float[np.ndarray, "*_ 3"])


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidTransform:
    """``y = rotation @ x + translation``, with R R^T = 1 and det R = 1.

    Variables are named after the frames: ``camera_from_board.points(x)`` are the camera's
    coordinates of the board's points x, and ``camera_from_board @ board_from_probe`` is
    ``camera_from_probe``. Leading dimensions are a batch. Everything is differentiable.
    """

    rotation: Float[Tensor, "*batch 3 3"]
    translation: Float[Tensor, "*batch 3"]

    def __post_init__(self) -> None:
        identity = torch.eye(3).to(self.rotation)
        off = (self.rotation @ self.rotation.mT - identity).abs()
        limit = _TOLERANCE * (1 if self.rotation.dtype == torch.float64 else 100)
        if not (off < limit).all() or (self.rotation.det() < 0).any():
            raise InputError("a rotation must be orthonormal and no mirror")
        if not self.translation.isfinite().all():
            raise InputError("a translation must be finite")

    @staticmethod
    def identity() -> "RigidTransform":
        """In float64."""
        return RigidTransform.translating(torch.zeros(3, dtype=torch.float64))

    @staticmethod
    def translating(translation: Float[Tensor, "*batch 3"]) -> "RigidTransform":
        """``y = x + translation``."""
        rotation = torch.eye(3).to(translation).expand(*translation.shape, 3)
        return RigidTransform(rotation=rotation, translation=translation)

    @staticmethod
    def from_numpy(
        rotation: Float[np.ndarray, "*batch 3 3"], translation: Float[np.ndarray, "*batch 3"]
    ) -> "RigidTransform":
        """In float64."""
        return RigidTransform(
            rotation=torch.tensor(rotation, dtype=torch.float64),
            translation=torch.tensor(translation, dtype=torch.float64),
        )

    @staticmethod
    def from_vector(vector: Float[Tensor, "*batch 6"]) -> "RigidTransform":
        """``rotation = exp([r]x)`` of a rotation vector r, rad (Rodrigues), and a translation t.

        These are OpenCV's ``rvec`` and ``tvec``.
        """
        turn, translation = vector.split(3, dim=-1)
        rotation = axis_angle_to_rotation_matrix(turn.reshape(-1, 3))
        return RigidTransform(rotation=rotation.reshape(*turn.shape, 3), translation=translation)

    @property
    def rotation_vector(self) -> Float[Tensor, "*batch 3"]:
        """log R: the axis times the angle, 0 to pi rad."""
        found = rotation_matrix_to_axis_angle(self.rotation.reshape(-1, 3, 3))
        return found.reshape(self.translation.shape)

    def vector(self) -> Float[Tensor, "*batch 6"]:
        """That of :meth:`from_vector`."""
        return torch.cat([self.rotation_vector, self.translation], -1)

    @property
    def angle_deg(self) -> Float[Tensor, "*batch"]:
        """How far it turns, 0 to 180 degrees."""
        return torch.rad2deg(self.rotation_vector.norm(dim=-1))

    def matrix(self) -> Float[Tensor, "*batch 4 4"]:
        """[[R, t], [0, 1]], of homogeneous coordinates."""
        last = torch.eye(4).to(self.rotation)[3:].expand(*self.translation.shape[:-1], 1, 4)
        return torch.cat([torch.cat([self.rotation, self.translation[..., None]], -1), last], -2)

    def __matmul__(self, other: "RigidTransform") -> "RigidTransform":
        """``(a @ b).points(x) = a.points(b.points(x))``."""
        return RigidTransform(
            rotation=self.rotation @ other.rotation,
            translation=self.points(other.translation),
        )

    def inverse(self) -> "RigidTransform":
        """``x = R^T (y - t)``."""
        back = self.rotation.mT
        shift = torch.einsum("...ij,...j->...i", back, self.translation)
        return RigidTransform(rotation=back, translation=-shift)

    def about(self, centre: Float[Tensor, "*batch 3"]) -> "RigidTransform":
        """The same motion with its rotation about ``centre``: ``R (x - c) + c + t``."""
        there = RigidTransform.translating(centre)
        return there @ self @ there.inverse()

    def points(self, points: Vectors) -> Vectors:
        """``R x + t``; leading dimensions broadcast with the batch's."""
        if isinstance(points, np.ndarray):
            return self.points(torch.tensor(points)).numpy()
        return self.directions(points) + self.translation.to(points)

    def directions(self, directions: Vectors) -> Vectors:
        """``R w``: directions are not moved by the translation."""
        if isinstance(directions, np.ndarray):
            return self.directions(torch.tensor(directions)).numpy()
        rotation = self.rotation.to(directions)
        if rotation.ndim == 2:  # a third of the time for few directions
            return directions @ rotation.T
        return torch.einsum("...ij,...j->...i", rotation, directions)
