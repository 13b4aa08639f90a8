"""Mesh files, read for shading, their size checked before memory is allocated.

trimesh reads them, from the plain form that :mod:`._gltf_mesh` and :mod:`._text_meshes` make.
"""

import logging
import math
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.errors import InputError
from skylight.io._bounded import file_bytes
from skylight.transport._gltf_mesh import plain_glb
from skylight.transport._text_meshes import plain_obj, plain_off, plain_ply, plain_stl

if TYPE_CHECKING:
    from trimesh import Trimesh

# its tracebacks of damaged files would go to standard error, and the exception says it
logging.getLogger("trimesh").addHandler(logging.NullHandler())

_PLAIN = {".obj": plain_obj, ".ply": plain_ply, ".stl": plain_stl, ".off": plain_off}
MESH_SUFFIXES = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
FARTHEST = 1e15  # rays are float32
CREASE_RAD = math.radians(40.0)  # edges sharper than this stay edges in shading


def read_mesh(path: str | Path) -> tuple[Float[Tensor, "n 3"], Int[Tensor, "f 3"]]:
    """Vertices and faces of a mesh file, in its own units and axes, as :func:`creased` has them.

    Vertices at the same place are one within each of its parts.

    Raises
    ------
    InputError
        A missing or damaged file, another format, what is not read, no faces or none with an
        area, or vertices that are not finite.
    """
    return creased(joined_mesh(Path(path)))


def joined_mesh(path: Path) -> "Trimesh":
    """The parts of a file as one mesh, vertices at the same place made one within each part.

    InputError as :func:`read_mesh`.
    """
    from trimesh.util import concatenate  # slow to import

    parts = loaded_parts(path)
    for mesh in parts:
        mesh.process()
    whole: Any = concatenate(parts)
    return whole


def loaded_parts(path: Path) -> list["Trimesh"]:
    """The meshes of a file as trimesh reads them, in place, those without faces left out.

    InputError as :func:`read_mesh`.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such mesh")
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(
            f"{path}: '{path.suffix}' is no mesh known here: use {', '.join(MESH_SUFFIXES)}"
        )
    try:
        parts = _parts(path)
        _require_area(parts)
        return parts
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    # the readers raise whatever their parsing stumbles over
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"{path}: not read as {path.suffix} ({reason}); export it again"
        ) from error


def _parts(path: Path) -> list["Trimesh"]:
    import trimesh
    from trimesh.resolvers import FilePathResolver

    suffix = path.suffix.lower()
    if suffix in (".glb", ".gltf"):
        content, suffix = plain_glb(path), ".glb"
    else:
        content = _PLAIN[suffix](file_bytes(path))
    meshes: Any = trimesh.load_scene(
        BytesIO(content),
        file_type=suffix[1:],
        resolver=FilePathResolver(str(path)),  # of materials and pictures beside it
        process=False,
    ).dump()
    parts = [mesh for mesh in meshes if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    for mesh in parts:
        # the merging would take an index below 0 for one from the end
        if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
            raise ValueError(f"its faces must index its {len(mesh.vertices)} vertices")
    return parts


def _require_area(parts: list["Trimesh"]) -> None:
    """Also what trimesh makes of a file that it does not understand is all in one place."""
    if not parts:
        raise InputError("the mesh has no faces: points and curves show no shading")
    for mesh in parts:
        require_coordinates(mesh.vertices)
    if not any((_doubled_areas(mesh) > 0).any() for mesh in parts):
        count = sum(len(mesh.faces) for mesh in parts)
        raise InputError(f"none of its {count} triangles has an area; export it again")


def _doubled_areas(mesh: "Trimesh") -> Float[np.ndarray, " f"]:
    """Of the mesh scaled to its extent, so that those of tiny ones are not 0."""
    places = np.asarray(mesh.vertices, np.float64)
    places = places - places.min(0)
    a, b, c = np.moveaxis((places / max(places.max(), 1e-300))[mesh.faces], 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)


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
