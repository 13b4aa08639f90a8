"""Meshes from files, ready to be shaded."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.errors import InputError

if TYPE_CHECKING:
    from trimesh import Trimesh

MESH_SUFFIXES = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
CREASE_RAD = math.radians(40.0)  # edges sharper than this stay edges in shading


def read_mesh(path: str | Path) -> tuple[Float[Tensor, "n 3"], Int[Tensor, "f 3"]]:
    """Vertices and faces of a mesh file, in its own units and axes, as :func:`creased` has them.

    Raises
    ------
    InputError
        A missing or damaged file, another format, no faces, or vertices that are not finite.
    """
    import trimesh  # slow to import

    path = Path(path)
    mesh = loaded_mesh(path, lambda file: trimesh.load_mesh(file, process=True))
    try:
        return creased(mesh)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def loaded_mesh(path: Path, load: Callable[[Path], Any]) -> Any:
    """What one of trimesh's readers makes of a mesh file.

    Raises
    ------
    InputError
        A missing or damaged file, or another format.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such mesh")
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(
            f"{path}: '{path.suffix}' is no mesh known here: use {', '.join(MESH_SUFFIXES)}"
        )
    try:
        return load(path)
    # the readers raise whatever their parsing stumbles over
    except Exception as error:
        raise InputError(f"{path}: damaged, or no {path.suffix} mesh ({error})") from error


def creased(mesh: "Trimesh") -> tuple[Float[Tensor, "n 3"], Int[Tensor, "f 3"]]:
    """Vertices and faces, vertices split where faces meet at more than 40 degrees.

    Normals that are averaged at the vertices are then smooth on smooth parts and break at edges.
    """
    from trimesh.graph import smooth_shade

    if not len(mesh.faces):
        raise InputError("the mesh has no faces: points and curves show no shading")
    if not np.isfinite(mesh.vertices).all():
        raise InputError("the mesh has vertices that are NaN or infinite; repair it")
    smooth = smooth_shade(mesh, angle=CREASE_RAD)
    vertices = torch.from_numpy(np.array(smooth.vertices, np.float64))
    return vertices, torch.from_numpy(np.array(smooth.faces, np.int64))
