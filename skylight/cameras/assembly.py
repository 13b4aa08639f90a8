"""What the assemblies of all probes have in common: a probe on a pole over a marker board."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.errors import InputError
from skylight.sphere.rigid_transform import RigidTransform
from skylight.transport.raycast import Raycaster

_SIDES = 24  # of the pole, as a prism

Pole = tuple[float, float, float, float]
"""(centre x, centre z, radius, height) of a cylinder, upright on the board, mm."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbeAssembly:
    """The pose of a printed probe over its marker board, in mm.

    ``board_mm`` is the width and height of the pattern that it was made for.
    """

    board_from_probe: RigidTransform
    pole_mm: Pole | None
    board_mm: tuple[float, float] | None

    def require_board(self, size_mm: tuple[float, float]) -> None:
        """Refuse a board of another size than the one the probe stands on, where that is known."""
        if self.board_mm is not None and not np.allclose(self.board_mm, size_mm, rtol=0.01):
            has, told = (f"{w:g} x {h:g} mm" for w, h in (self.board_mm, size_mm))
            raise InputError(
                f"the probe stands on a board of {has}, the board's file says {told}: give the "
                "one that was printed"
            )

    def placement_json(self) -> dict[str, object]:
        """What :func:`read_placement` reads."""
        return {
            "rotation": self.board_from_probe.rotation.tolist(),
            "translation_mm": self.board_from_probe.translation.tolist(),
            "pole_mm": None if self.pole_mm is None else list(self.pole_mm),
            "board_mm": None if self.board_mm is None else list(self.board_mm),
        }


def read_placement(content: Mapping[str, object]) -> dict[str, Any]:
    """The fields of a :class:`ProbeAssembly` in an assembly file.

    Raises
    ------
    TypeError, ValueError
        Numbers of another shape, texts, or lengths that are not above 0.
    """

    def numbers(key: str, *shape: int) -> Float[np.ndarray, "..."]:
        found = np.array(content[key])
        if found.dtype.kind not in "if":  # of texts numpy would make numbers, "inf" among them
            raise TypeError(f"{key}: numbers are needed")
        return found.astype(np.float64).reshape(shape)

    def lengths(key: str, count: int) -> tuple[float, ...] | None:
        if content.get(key) is None:
            return None
        found = numbers(key, count)
        if not (found[-2:] > 0).all():  # radius and height, width and height
            raise ValueError(f"{key}: its last two must be above 0")
        return tuple(found.tolist())

    return {
        "board_from_probe": RigidTransform.from_numpy(
            numbers("rotation", 3, 3), numbers("translation_mm", 3)
        ),
        "pole_mm": lengths("pole_mm", 4),
        "board_mm": lengths("board_mm", 2),
    }


def cylinder_mesh(pole: Pole) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "f 3"]]:
    """(vertices, triangles) of a pole's side, as flat strips."""
    x, z, radius, height = pole
    angle = np.arange(_SIDES) * (2 * np.pi / _SIDES)
    ring = np.stack([x + radius * np.cos(angle), 0 * angle, z + radius * np.sin(angle)], 1)
    i = np.arange(_SIDES)
    j = (i + 1) % _SIDES
    strips = np.concatenate(
        [np.stack([i, j, j + _SIDES], 1), np.stack([i, j + _SIDES, i + _SIDES], 1)]
    )
    return np.concatenate([ring, ring + np.array([0.0, height, 0.0])]), strips


def unoccluded(
    caster: Raycaster, eye: Float[np.ndarray, "3"], points: Float[np.ndarray, "*n 3"]
) -> Float[Tensor, "*n"]:
    """Visibility V: 1 where nothing is between a point of a surface and the eye, 0 elsewhere."""
    flat = torch.from_numpy(points.reshape(-1, 3))
    towards = torch.from_numpy(eye) - flat
    # past the surface the point lies on; the eye is outside of everything
    start = flat + caster.epsilon * towards / towards.norm(dim=1, keepdim=True)
    free = ~caster.occluded(start, towards)
    return free.double().reshape(points.shape[:-1])
