"""Mesh files, read for shading."""

import logging
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.errors import InputError
from skylight.transport.mesh_bounds import require_bounded

if TYPE_CHECKING:
    from trimesh import Trimesh

# its tracebacks of damaged files would go to standard error, and the exception says it
logging.getLogger("trimesh").addHandler(logging.NullHandler())

MESH_SUFFIXES = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
FARTHEST = 1e15  # rays are float32
CREASE_RAD = math.radians(40.0)  # edges sharper than this stay edges in shading


def read_mesh(path: str | Path) -> tuple[Float[Tensor, "n 3"], Int[Tensor, "f 3"]]:
    """Vertices and faces of a mesh file, in its own units and axes, as :func:`creased` has them.

    Raises
    ------
    InputError
        A missing or damaged file, another format, no faces, or vertices that are not finite.
    """
    path = Path(path)
    mesh = loaded_mesh(path, _merged)
    try:
        return creased(mesh)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _merged(path: Path) -> "Trimesh":
    """All meshes of a file as one, vertices at the same place made one within each."""
    import trimesh  # slow to import

    meshes: Any = trimesh.load_scene(path, process=False).dump()
    parts = [mesh for mesh in meshes if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    for mesh in parts:
        # the merging would take an index below 0 for one from the end
        if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
            raise ValueError(f"its faces must index its {len(mesh.vertices)} vertices")
        mesh.process()
    whole: Any = trimesh.util.concatenate(parts) if parts else trimesh.Trimesh()
    return whole


def loaded_mesh(path: Path, load: Callable[[Path], Any]) -> Any:
    """What one of trimesh's readers makes of a mesh file.

    Raises
    ------
    InputError
        A missing, damaged or too large file, or another format.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such mesh")
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(
            f"{path}: '{path.suffix}' is no mesh known here: use {', '.join(MESH_SUFFIXES)}"
        )
    try:
        require_bounded(path)
        return load(path)
    # the readers raise whatever their parsing stumbles over
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: damaged, or no {path.suffix} mesh ({reason})") from error


def require_coordinates(vertices: Float[np.ndarray, "n k"]) -> None:
    """Raise :class:`InputError` for vertices that are not finite, or whose squares may not be.

    Also where there are not three to each, which the readers let pass.
    """
    if vertices.shape[1] != 3:
        raise InputError(f"the mesh has vertices of {vertices.shape[1]} coordinates; repair it")
    if not (np.abs(vertices) < FARTHEST).all():  # false for NaN too
        raise InputError(
            f"the mesh has vertices that are NaN, infinite or beyond {FARTHEST:g}; repair it"
        )


def creased(mesh: "Trimesh") -> tuple[Float[Tensor, "n 3"], Int[Tensor, "f 3"]]:
    """Vertices and faces, vertices split where faces meet at more than 40 degrees.

    Normals that are averaged at the vertices are then smooth on smooth parts and break at edges.
    """
    from trimesh.graph import smooth_shade

    if not len(mesh.faces):
        raise InputError("the mesh has no faces: points and curves show no shading")
    require_coordinates(mesh.vertices)
    smooth = smooth_shade(mesh, angle=CREASE_RAD)
    vertices = torch.from_numpy(np.array(smooth.vertices, np.float64))
    return vertices, torch.from_numpy(np.array(smooth.faces, np.int64))
