"""Meshes that stay closed in a file: STL holds three float32 corners for each triangle, no more.

Readers take corners at the same place for one vertex, and a mesh is closed where each edge then has
two triangles. Booleans leave vertices closer than float32 can tell, which makes lines of triangles;
slits without a width, and solids that touch along an edge, each of which then has four triangles.
So vertices are welded, slits simplified away, and such an edge is parted by a narrow groove.
"""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

if TYPE_CHECKING:
    from manifold3d import Manifold

# vertices are farther apart: of two at that distance, at 1 m from the origin at most, a coordinate
# differs by 1.15e-4 (over sqrt(3)), and float32 rounds each by 3.1e-5
RESOLUTION_MM = 2e-4
_GROOVE_MM = 0.02  # less than printers show
_TRIES = 4


def watertight_mesh(solid: "Manifold") -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "f 3"]]:
    """(vertices, faces) of a solid whose vertices are more than ``RESOLUTION_MM`` apart.

    Surfaces are moved by that simplifying and by welding, by a micrometre together; along edges
    where the solid touches itself, 0.02 mm are cut away.
    """
    from manifold3d import Manifold, OpType

    for _ in range(_TRIES):
        vertices, faces = _welded(solid.as_original().simplify(RESOLUTION_MM))
        touching = broken_edges(vertices[faces])
        if not len(touching):
            break
        octahedron = _GROOVE_MM * np.concatenate([np.eye(3), -np.eye(3)])
        around = (touching[:, :, None] + octahedron).reshape(-1, 12, 3)
        grooves = [Manifold.hull_points(points) for points in around]
        solid = solid - Manifold.batch_boolean(grooves, OpType.Add)
    return vertices, faces


def by_place(
    corners: Float[np.ndarray, "f 3 3"],
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "f 3"]]:
    """(vertices, faces) of triangles as readers of an STL file take them, in float32."""
    places = corners.astype(np.float32).reshape(-1, 3)
    vertices, faces = np.unique(places, axis=0, return_inverse=True)
    return vertices.astype(np.float64), faces.reshape(-1, 3).astype(np.int64)


def broken_edges(corners: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "k 2 3"]:
    """Both ends of edges that have not exactly two triangles in a file."""
    vertices, faces = by_place(corners)
    edges = np.sort(np.concatenate([faces[:, :2], faces[:, 1:], faces[:, ::2]]), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    return vertices[edges[count != 2]]


def _welded(solid: "Manifold") -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "f 3"]]:
    """Of vertices closer than ``RESOLUTION_MM`` the first stays; lines of triangles go."""
    mesh = solid.to_mesh64()
    vertices = np.array(mesh.vert_properties, np.float64)[:, :3]
    faces = np.array(mesh.tri_verts, np.int64)
    first, second = KDTree(vertices).query_pairs(RESOLUTION_MM, output_type="ndarray").T
    links = coo_array((np.ones(len(first)), (first, second)), shape=(len(vertices),) * 2)
    _, group = connected_components(links, directed=False)
    _, kept = np.unique(group, return_index=True)
    faces = group[faces]
    line = (faces == np.roll(faces, 1, axis=1)).any(1)
    used, faces = np.unique(faces[~line], return_inverse=True)
    return vertices[kept[used]], faces.reshape(-1, 3).astype(np.int64)
