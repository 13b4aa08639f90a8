"""Meshes from files, ready to be shaded."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

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

    path = existing_mesh(path)
    try:
        mesh = trimesh.load_mesh(path, process=True)
    # its readers raise whatever their parsing stumbles over
    except Exception as error:
        raise InputError(f"{path}: damaged, or no {path.suffix} mesh ({error})") from error
    try:
        return creased(mesh)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def existing_mesh(path: str | Path) -> Path:
    """The path, once it is sure that a file with a mesh's ending is there."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: there is no such mesh")
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(
            f"{path}: '{path.suffix}' is no mesh known here: use {', '.join(MESH_SUFFIXES)}"
        )
    return path


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
