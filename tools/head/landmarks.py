"""Where the 68 landmarks are, and the vertices that are moved onto them."""

from dataclasses import replace

import igl
import numpy as np

from tools.head.cage import mirror_map
from tools.head.shape import Shape

# The 68 iBUG landmarks on the mean head, millimetres, for the person's right side (x <= 0, left in
# the picture) and the midline. Found by running dlib's 68-point predictor on 35 shaded renderings
# of the head (7 identities x 5 poses within 10 degrees of frontal, painted brows and irises),
# casting the marks back onto the surface, taking medians and averaging with the mirror image; the
# jaw from the frontal renderings only. Corrected by hand: the inner lip corners (60) lie in the
# corner between the lips, and jaw point 2, grazed by its ray, keeps its neighbours' depth.
LANDMARKS_MM = {
    0: (-75.8, 5.7, -18.6), 1: (-74.2, -16.7, -12.8), 2: (-70.5, -37.7, -4.0),
    3: (-66.4, -56.3, 4.8), 4: (-59.6, -74.6, 15.3), 5: (-49.6, -90.6, 23.7),
    6: (-35.9, -104.3, 31.1), 7: (-18.8, -113.2, 43.6), 8: (0.0, -115.8, 48.2),
    17: (-60.6, 16.9, 33.5), 18: (-50.7, 25.8, 49.0), 19: (-37.0, 28.4, 60.4),
    20: (-23.4, 26.5, 66.3), 21: (-11.6, 20.3, 68.4),
    27: (0.0, 1.0, 64.6), 28: (0.0, -12.2, 67.6), 29: (0.0, -25.0, 74.7), 30: (0.0, -37.8, 83.1),
    31: (-13.4, -45.7, 66.7), 32: (-6.9, -48.4, 70.2), 33: (0.0, -50.6, 72.1),
    36: (-44.6, -1.4, 49.9), 37: (-36.4, 1.6, 55.5), 38: (-26.5, 1.7, 55.2),
    39: (-18.4, -3.8, 52.8), 40: (-27.1, -7.0, 55.2), 41: (-37.3, -6.8, 54.3),
    48: (-22.8, -72.6, 58.6), 49: (-14.3, -66.8, 69.3), 50: (-6.0, -63.4, 72.8),
    51: (0.0, -65.1, 73.7), 57: (0.0, -84.9, 68.3), 58: (-6.7, -84.3, 67.5),
    59: (-15.0, -81.1, 65.1), 60: (-20.4, -72.4, 59.8), 61: (-6.1, -71.1, 67.5),
    62: (0.0, -71.6, 67.4), 66: (0.0, -72.7, 67.4), 67: (-6.2, -72.3, 65.7),
}  # fmt: skip
# Landmark i's mirror image.
MIRROR = np.array(
    [
        *range(16, -1, -1),
        *range(26, 16, -1),
        *(27, 28, 29, 30, 35, 34, 33, 32, 31),
        *(45, 44, 43, 42, 47, 46, 39, 38, 37, 36, 41, 40),
        *(54, 53, 52, 51, 50, 49, 48, 59, 58, 57, 56, 55, 64, 63, 62, 61, 60, 67, 66, 65),
    ]
)


def pin_landmarks(shape: Shape) -> tuple[Shape, np.ndarray]:
    """Slide the nearest skin vertex onto each landmark; the new shape and those vertices (68,).

    A vertex's row of the mean and of every basis becomes the barycentric mix of the triangle the
    landmark falls in, so the landmark is that vertex for every head, and deformation handles placed
    there interpolate it exactly. Vertices move along the surface by less than an edge.
    """
    wanted = np.full((68, 3), np.nan)
    for i, position in LANDMARKS_MM.items():
        wanted[i] = np.array(position) * 1e-3
        wanted[MIRROR[i]] = wanted[i] * [-1, 1, 1]
    skin = shape.faces[(shape.part[shape.faces] == 0).all(axis=1)]
    mirror = mirror_map(shape.mean, shape.part)
    _, hit, point = igl.point_mesh_squared_distance(wanted, shape.mean, skin)

    sources = (shape.mean, shape.identity, shape.expression)
    moved = tuple(array.copy() for array in sources)
    vertex = np.full(68, -1)

    def turn(v: int, position: np.ndarray) -> float:
        """Smallest cosine between old and new normals of the triangles of ``v``, if moved."""
        ring = shape.faces[(shape.faces == v).any(axis=1)]
        old = shape.mean[ring]
        new = np.where((ring == v)[..., None], position, old)
        n0, n1 = (np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) for t in (old, new))
        size = np.linalg.norm(n0, axis=1) * np.linalg.norm(n1, axis=1)
        return float(((n0 * n1).sum(axis=1) / size.clip(1e-20)).min())

    for i in LANDMARKS_MM:
        corners = skin[hit[i]]
        bary = igl.barycentric_coordinates(
            point[i : i + 1], *(shape.mean[corners[j] : corners[j] + 1] for j in range(3))
        )[0]
        if MIRROR[i] == i:  # stay exactly on the midline
            bary = np.where(np.abs(shape.mean[corners, 0]) < 1e-6, bary, 0.0)
            bary /= bary.sum()
        goal = bary @ shape.mean[corners]
        free = [j for j in np.argsort(-bary) if bary[j] > 0 and corners[j] not in vertex]
        safe = [j for j in free if turn(corners[j], goal) > 0.5]
        if safe:
            vertex[i] = corners[safe[0]]
        else:  # in a fold: take the nearest vertex where it is
            vertex[i] = corners[free[0]]
            bary = np.eye(3)[free[0]]
            off = np.linalg.norm(shape.mean[vertex[i]] - goal)
            print(f"landmark {i}: {off * 1e3:.1f} mm off, its vertex cannot slide")
        vertex[MIRROR[i]] = mirror[vertex[i]]
        for array, source in zip(moved, sources, strict=True):
            array[vertex[i]] = np.tensordot(bary, source[corners], axes=1)
            if MIRROR[i] != i:
                array[vertex[MIRROR[i]]] = np.tensordot(bary, source[mirror[corners]], axes=1)
    if len(set(vertex.tolist())) != 68:
        raise SystemExit("two landmarks fall on one vertex")
    return replace(shape, mean=moved[0], identity=moved[1], expression=moved[2]), vertex
