"""A printed voxel probe over its marker board: its file, its faces there, and what hides them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.io._bounded import read_object, require_keys
from skylight.probes.cameras._board import (
    Pole,
    ProbeAssembly,
    cylinder_mesh,
    read_placement,
    unoccluded,
)
from skylight.probes.voxel._model import NORMALS, VoxelFaces, VoxelModel, exposed_faces
from skylight.transport._rays import Raycaster

_KIND, _VERSION = "voxel probe assembly", 1
_LARGEST = 64


@dataclass(frozen=True, kw_only=True, eq=False)
class VoxelAssembly(ProbeAssembly):
    """What was printed, and where: the probe's frame has cells of ``voxel_mm`` along its axes."""

    model: VoxelModel
    voxel_mm: float
    pole_mm: Pole | None = None
    board_mm: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.voxel_mm) and self.voxel_mm > 0):
            raise InputError("an assembly needs voxels above 0 mm")

    def to_board(self, cells: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Cell coordinates in mm of the board."""
        return self.board_from_probe.points(self.voxel_mm * cells)

    def to_json(self) -> dict[str, object]:
        """What :func:`load_voxel_assembly` reads; a file may hold more."""
        return {
            "kind": _KIND,
            "format": _VERSION,
            "cells": np.argwhere(self.model.occupied).tolist(),
            "voxel_mm": self.voxel_mm,
            **self.placement_json(),
        }


class PlacedProbe:
    """The faces of a probe in the board's frame, and what occludes them: the probe and its pole."""

    def __init__(self, assembly: VoxelAssembly) -> None:
        self.assembly = assembly
        self.faces: VoxelFaces = exposed_faces(assembly.model)
        self.corners = assembly.to_board(self.faces.corners.numpy())
        normals = NORMALS[self.faces.orientation.numpy()].astype(float)
        self.normals = assembly.board_from_probe.directions(normals)
        vertices, triangles = (part.numpy() for part in self.faces.triangles())
        vertices = assembly.to_board(vertices)
        if assembly.pole_mm is not None:
            pole, strips = cylinder_mesh(assembly.pole_mm)
            triangles = np.concatenate([triangles, strips + len(vertices)])
            vertices = np.concatenate([vertices, pole])
        self._caster = Raycaster(torch.from_numpy(vertices), torch.from_numpy(triangles))

    def sees(
        self, eye: Float[np.ndarray, "3"], points: Float[np.ndarray, "*n 3"]
    ) -> Float[Tensor, "*n"]:
        """1 where nothing is between a point of a face and the eye, 0 elsewhere."""
        return unoccluded(self._caster, eye, points)


def load_voxel_assembly(path: str | Path) -> VoxelAssembly:
    """The assembly that :meth:`VoxelAssembly.to_json` wrote."""
    content = read_object(path, _KIND)
    require_keys(path, content, ["format", "cells", "voxel_mm", "rotation", "translation_mm"])
    if content["format"] != _VERSION:
        raise InputError(f"{path}: of format {content['format']}, this program reads {_VERSION}")
    try:
        cells = np.array(content["cells"]).reshape(-1, 3)
        voxel_mm = float(content["voxel_mm"])  # type: ignore[arg-type]
        placement = read_placement(content)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: its numbers are not those of an assembly ({error})") from error
    whole = cells.dtype.kind == "i" and len(cells) > 0
    if not whole or cells.min() < 0 or cells.max() >= _LARGEST:
        raise InputError(
            f"{path}: a probe's cells are 1 or more, whole numbers from 0 to {_LARGEST - 1}"
        )
    solid = np.zeros(cells.max(0) + 1, bool)
    solid[tuple(cells.T)] = True
    return VoxelAssembly(model=VoxelModel(occupied=solid), voxel_mm=voxel_mm, **placement)
