"""Probes that stand on a pole over a marker board: what their assembly files have in common."""

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.errors import InputError
from skylight.transport.raycast import Raycaster

_SIDES = 24  # of the pole, as a prism

Pole = tuple[float, float, float, float]


def require_rigid(
    rotation: Float[np.ndarray, "3 3"], translation_mm: Float[np.ndarray, " 3"]
) -> None:
    """Refuse what is no rotation and shift."""
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not (off < 1e-6 and np.linalg.det(rotation) > 0):
        raise InputError("a placement's rotation must be orthonormal and no mirror")
    if not np.isfinite(translation_mm).all():
        raise InputError("a placement needs a finite translation")


def require_board(made_for: tuple[float, float] | None, size_mm: tuple[float, float]) -> None:
    """Refuse a board of another size than the one a probe was made for, where that is known."""
    if made_for is not None and not np.allclose(made_for, size_mm, rtol=0.01):
        has, told = (f"{w:g} x {h:g} mm" for w, h in (made_for, size_mm))
        raise InputError(
            f"the probe stands on a board of {has}, the board's file says {told}: give the "
            "one that was printed"
        )


def cylinder_mesh(pole: Pole) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "f 3"]]:
    """(vertices, triangles) of a pole's side, as flat strips.

    The pole is (centre x, centre z, radius, height), upright on the board, mm.
    """
    x, z, radius, height = pole
    angle = np.arange(_SIDES) * (2 * np.pi / _SIDES)
    ring = np.stack([x + radius * np.cos(angle), 0 * angle, z + radius * np.sin(angle)], 1)
    i = np.arange(_SIDES)
    j = (i + 1) % _SIDES
    strips = np.concatenate(
        [np.stack([i, j, j + _SIDES], 1), np.stack([i, j + _SIDES, i + _SIDES], 1)]
    )
    return np.concatenate([ring, ring + np.array([0.0, height, 0.0])]), strips


def unhidden(
    caster: Raycaster, eye: Float[np.ndarray, "3"], points: Float[np.ndarray, "*n 3"]
) -> Float[Tensor, "*n"]:
    """1 where nothing is between a point of a surface and the eye, 0 elsewhere."""
    flat = torch.from_numpy(points.reshape(-1, 3))
    towards = torch.from_numpy(eye) - flat
    # past the surface the point lies on; the eye is outside of everything
    start = flat + caster.epsilon * towards / towards.norm(dim=1, keepdim=True)
    free = ~caster.occluded(start, towards)
    return free.double().reshape(points.shape[:-1])


def read_stand(
    content: Mapping[str, object],
) -> tuple[np.ndarray, np.ndarray, Pole | None, tuple[float, float] | None]:
    """(rotation, translation, pole or None, board's size or None) of an assembly file.

    Numbers of another shape raise ``TypeError`` or ``ValueError``.
    """
    rotation = np.array(content["rotation"], dtype=np.float64).reshape(3, 3)
    translation = np.array(content["translation_mm"], dtype=np.float64).reshape(3)
    listed, size = content.get("pole_mm"), content.get("board_mm")
    pole = board = None
    if listed is not None:
        x, z, radius, height = np.array(listed, dtype=np.float64).reshape(4).tolist()
        pole = x, z, radius, height
    if size is not None:
        width, depth = np.array(size, dtype=np.float64).reshape(2).tolist()
        board = width, depth
    return rotation, translation, pole, board
