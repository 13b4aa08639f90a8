"""Which region of the head each vertex belongs to."""

import itertools

import numpy as np
from trimesh import Trimesh

from tools.head.shape import Shape


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.zeros_like(vertices)
    for j in range(3):
        np.add.at(total, faces[:, j], normal)
    return total / np.linalg.norm(total, axis=1, keepdims=True).clip(1e-12)


def openness(vertices: np.ndarray, faces: np.ndarray, rays: int = 96) -> np.ndarray:
    """Cosine-weighted share (n,) of each vertex's outward hemisphere that leaves the head."""
    mesh = Trimesh(vertices, faces, process=False)
    normal = vertex_normals(vertices, faces)
    index = np.arange(rays)
    height = 1 - 2 * (index + 0.5) / rays  # Fibonacci sphere
    angle = np.pi * (1 + 5**0.5) * index
    radius = np.sqrt(1 - height**2)
    sphere = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
    free, total = np.zeros(len(vertices)), np.zeros(len(vertices))
    for direction in sphere:
        cosine = normal @ direction
        up = np.flatnonzero(cosine > 0)
        origin = vertices[up] + 2e-4 * normal[up]
        blocked = mesh.ray.intersects_any(origin, np.tile(direction, (len(up), 1)))
        total[up] += cosine[up]
        free[up] += cosine[up] * ~blocked
    return free / total.clip(1e-12)


def inside(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which of ``points`` (n, 2) lie in ``polygon`` (m, 2), by ray crossing."""
    x, y = points.T
    odd = np.zeros(len(points), dtype=bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if y0 != y1:
            odd ^= ((y0 > y) != (y1 > y)) & (x < (x1 - x0) * (y - y0) / (y1 - y0) + x0)
    return odd


def label_regions(shape: Shape, landmark: np.ndarray) -> np.ndarray:
    """Region of each vertex (n,) uint8, the values of ``skylight.faces._model.Region``.

    Geometry of the mean head only; the hairline follows the facial thirds (trichion about 65 mm
    above the nasion, Farkas 1994).
    """
    skin = shape.part == 0
    x, y, z = shape.mean.T * 1e3
    free = openness(shape.mean, shape.faces)
    mark = shape.mean[landmark] * 1e3
    frontal = shape.mean[:, :2] * 1e3

    region = np.zeros(len(x), dtype=np.uint8)
    # Jaw line, seen from the side: from the angle of the jaw (z -8) down to the chin (z 46).
    neck = y < -119 + 0.85 * np.maximum(0.0, 46 - np.maximum(z, -8))
    hair_z = np.interp(y, [-30, 0, 25, 50, 62], [-12, -5, 8, 22, 40])
    region[(z < hair_z) | (y > 62)] = 4
    region[neck] = 6
    region[shape.ear > 0.03] = 5

    for brow in (mark[17:22], mark[22:27]):
        # dlib marks the brow's upper half: the hairs' middle lies a little lower.
        line = np.concatenate([np.linspace(a, b, 9) for a, b in itertools.pairwise(brow)]) - [
            0,
            2,
            0,
        ]
        apart = np.linalg.norm(shape.mean[:, None] * 1e3 - line[None], axis=2).min(axis=1)
        region[apart < 5.5] = 3
    region[inside(mark[48:60, :2], frontal) & (z > 45)] = 7
    for eye in (mark[36:42, :2], mark[42:48, :2]):
        centre = eye.mean(axis=0)
        region[inside(centre + 1.1 * (eye - centre), frontal) & (z > 30)] = 8
    deep = free < 0.12
    mouth = (np.abs(x) < 35) & (y < -58) & (y > -102) & (z > 0)
    region[skin & deep & ~mouth & (region != 5)] = 8
    region[skin & (free < 0.2) & mouth & (region != 6)] = 2
    region[(shape.part == 1) | (shape.part == 2)] = 1
    region[shape.part == 3] = 2
    return region
