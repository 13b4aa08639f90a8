"""Where a printed voxel probe stands: its cells in the millimetres of the marker board."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.capture.json_files import read_object, require_keys
from skylight.probes.voxel.faces import NORMALS, VoxelFaces, exposed_faces
from skylight.probes.voxel.model import VoxelModel
from skylight.transport.raycast import Raycaster

_KIND, _VERSION = "voxel probe assembly", 1
_LARGEST = 64


@dataclass(frozen=True, kw_only=True)
class Placement:
    """A point x in cells stands at ``rotation @ (voxel_mm * x) + translation_mm``."""

    voxel_mm: float
    rotation: Float[np.ndarray, "3 3"]
    translation_mm: Float[np.ndarray, "3"]

    def __post_init__(self) -> None:
        off = np.abs(self.rotation @ self.rotation.T - np.eye(3)).max()
        if not (off < 1e-6 and np.linalg.det(self.rotation) > 0):
            raise InputError("a placement's rotation must be orthonormal and no mirror")
        finite = np.isfinite(self.translation_mm).all() and np.isfinite(self.voxel_mm)
        if not (finite and self.voxel_mm > 0):
            raise InputError("a placement needs voxels above 0 mm and a finite translation")

    @property
    def matrix(self) -> Float[Tensor, "4 4"]:
        """From cells to millimetres of the board."""
        out = torch.eye(4, dtype=torch.float64)
        out[:3, :3] = torch.from_numpy(self.voxel_mm * self.rotation)
        out[:3, 3] = torch.from_numpy(self.translation_mm)
        return out

    def to_board(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        return self.voxel_mm * points @ self.rotation.T + self.translation_mm


class PlacedProbe:
    """The faces of a probe in the board's frame, and what stands in their way.

    ``obstacle`` is a mesh in the same millimetres (vertices, triangles): the pole, the base.
    """

    def __init__(
        self,
        model: VoxelModel,
        placement: Placement,
        obstacle: tuple[Float[np.ndarray, "n 3"], np.ndarray] | None = None,
    ) -> None:
        self.model, self.placement, self.obstacle = model, placement, obstacle
        self.faces: VoxelFaces = exposed_faces(model)
        self.corners = placement.to_board(self.faces.corners.numpy())
        normals = NORMALS[self.faces.orientation.numpy()].astype(float)
        self.normals = normals @ placement.rotation.T
        vertices, triangles = self.faces.triangles()
        placed = placement.to_board(vertices.numpy())
        everything = triangles.numpy()
        if obstacle is not None:
            everything = np.concatenate([everything, obstacle[1] + len(placed)])
            placed = np.concatenate([placed, obstacle[0]])
        self._caster = Raycaster(torch.from_numpy(placed), torch.from_numpy(everything))

    def sees(
        self, eye: Float[np.ndarray, "3"], points: Float[np.ndarray, "*n 3"]
    ) -> Float[Tensor, "*n"]:
        """1 where nothing is between a point of a face and the eye, 0 elsewhere."""
        flat = torch.from_numpy(points.reshape(-1, 3))
        towards = torch.from_numpy(eye) - flat
        # past the surface the point lies on; the eye is outside of everything
        start = flat + self._caster.epsilon * towards / towards.norm(dim=1, keepdim=True)
        free = ~self._caster.occluded(start, towards)
        return free.double().reshape(points.shape[:-1])


@dataclass(frozen=True, kw_only=True)
class StandingProbe:
    """What was printed and where it stands: the probe, its place over the board, and its pole.

    The pole is a cylinder (centre x, centre z, radius, height), upright on the board, mm.
    ``board_mm`` is the width and height of the pattern that it was made for, where that is known.
    """

    model: VoxelModel
    placement: Placement
    pole_mm: tuple[float, float, float, float] | None = None
    board_mm: tuple[float, float] | None = None

    def require_board(self, size_mm: tuple[float, float]) -> None:
        """Refuse a board of another size than the one the probe stands on."""
        if self.board_mm is not None and not np.allclose(self.board_mm, size_mm, rtol=0.01):
            has, told = (f"{w:g} x {h:g} mm" for w, h in (self.board_mm, size_mm))
            raise InputError(
                f"the probe stands on a board of {has}, the board's file says {told}: give the "
                "one that was printed"
            )

    def placed(self) -> PlacedProbe:
        return PlacedProbe(
            self.model, self.placement, None if self.pole_mm is None else _cylinder(*self.pole_mm)
        )


def describe_standing_probe(probe: StandingProbe) -> dict[str, object]:
    """What :func:`load_standing_probe` reads; a file may say more."""
    place = probe.placement
    return {
        "kind": _KIND,
        "format": _VERSION,
        "cells": np.argwhere(probe.model.occupied).tolist(),
        "voxel_mm": place.voxel_mm,
        "rotation": place.rotation.tolist(),
        "translation_mm": place.translation_mm.tolist(),
        "pole_mm": None if probe.pole_mm is None else list(probe.pole_mm),
        "board_mm": None if probe.board_mm is None else list(probe.board_mm),
    }


def load_standing_probe(path: str | Path) -> StandingProbe:
    """A probe as :func:`describe_standing_probe` tells it, from JSON.

    Raises
    ------
    InputError
        The file cannot be read as one, or its numbers are no placement.
    """
    content = read_object(path, _KIND)
    require_keys(path, content, ["format", "cells", "voxel_mm", "rotation", "translation_mm"])
    if content["format"] != _VERSION:
        raise InputError(f"{path}: of format {content['format']}, this program reads {_VERSION}")
    try:
        cells = np.array(content["cells"], dtype=np.int64).reshape(-1, 3)
        rotation = np.array(content["rotation"], dtype=np.float64).reshape(3, 3)
        translation = np.array(content["translation_mm"], dtype=np.float64).reshape(3)
        voxel_mm = float(content["voxel_mm"])  # type: ignore[arg-type]
        listed = content.get("pole_mm")
        pole = None if listed is None else np.array(listed, dtype=np.float64).reshape(4).tolist()
        size = content.get("board_mm")
        board = None if size is None else np.array(size, dtype=np.float64).reshape(2).tolist()
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: its numbers are not those of an assembly ({error})") from error
    if not len(cells) or cells.min() < 0 or cells.max() >= _LARGEST:
        raise InputError(f"{path}: a probe's cells are 1 or more, from 0 to {_LARGEST - 1}")
    solid = np.zeros(cells.max(0) + 1, bool)
    solid[tuple(cells.T)] = True
    return StandingProbe(
        model=VoxelModel(occupied=solid),
        placement=Placement(voxel_mm=voxel_mm, rotation=rotation, translation_mm=translation),
        pole_mm=None if pole is None else (pole[0], pole[1], pole[2], pole[3]),
        board_mm=None if board is None else (board[0], board[1]),
    )


def _cylinder(
    x: float, z: float, radius: float, height: float
) -> tuple[Float[np.ndarray, "n 3"], np.ndarray]:
    """Its side, as 24 flat strips."""
    angle = np.arange(24) * (2 * np.pi / 24)
    ring = np.stack([x + radius * np.cos(angle), 0 * angle, z + radius * np.sin(angle)], 1)
    i = np.arange(24)
    j = (i + 1) % 24
    strips = np.concatenate([np.stack([i, j, j + 24], 1), np.stack([i, j + 24, i + 24], 1)])
    return np.concatenate([ring, ring + np.array([0.0, height, 0.0])]), strips
