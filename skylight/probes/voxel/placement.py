"""Where a printed voxel probe stands: its cells in the millimetres of the marker board."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.capture.json_files import read_object, require_keys
from skylight.probes.capture.standing import (
    Pole,
    cylinder_mesh,
    read_stand,
    require_board,
    require_rigid,
    unhidden,
)
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
        require_rigid(self.rotation, self.translation_mm)
        if not (np.isfinite(self.voxel_mm) and self.voxel_mm > 0):
            raise InputError("a placement needs voxels above 0 mm")

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
        return unhidden(self._caster, eye, points)


@dataclass(frozen=True, kw_only=True)
class StandingProbe:
    """What was printed and where it stands: the probe, its place over the board, and its pole.

    The pole is a cylinder (centre x, centre z, radius, height), upright on the board, mm.
    ``board_mm`` is the width and height of the pattern that it was made for, where that is known.
    """

    model: VoxelModel
    placement: Placement
    pole_mm: Pole | None = None
    board_mm: tuple[float, float] | None = None

    def require_board(self, size_mm: tuple[float, float]) -> None:
        """Refuse a board of another size than the one the probe stands on."""
        require_board(self.board_mm, size_mm)

    def placed(self) -> PlacedProbe:
        return PlacedProbe(
            self.model,
            self.placement,
            None if self.pole_mm is None else cylinder_mesh(self.pole_mm),
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
        voxel_mm = float(content["voxel_mm"])  # type: ignore[arg-type]
        rotation, translation, pole, board = read_stand(content)
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: its numbers are not those of an assembly ({error})") from error
    if not len(cells) or cells.min() < 0 or cells.max() >= _LARGEST:
        raise InputError(f"{path}: a probe's cells are 1 or more, from 0 to {_LARGEST - 1}")
    solid = np.zeros(cells.max(0) + 1, bool)
    solid[tuple(cells.T)] = True
    return StandingProbe(
        model=VoxelModel(occupied=solid),
        placement=Placement(voxel_mm=voxel_mm, rotation=rotation, translation_mm=translation),
        pole_mm=pole,
        board_mm=board,
    )
