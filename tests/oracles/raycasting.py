"""Is anything in a ray's way? Every triangle tried with every ray, in float64."""

import numpy as np


def occluded(vertices, faces, origins, directions):
    """(hit (r,) bool, doubtful (r,) bool): doubtful rays pass an edge within 1e-5 of its length.

    Moeller and Trumbore 1997: o + t d = (1 - u - v) a + u b + v c.
    """
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    hit = np.zeros(len(origins), bool)
    doubtful = np.zeros(len(origins), bool)
    for i, (o, d) in enumerate(zip(origins, directions, strict=True)):
        p = np.cross(d, c - a)
        scale = np.sum((b - a) * p, axis=1)
        q = np.cross(o - a, b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.sum((o - a) * p, axis=1) / scale
            v = np.sum(d * q, axis=1) / scale
            t = np.sum((c - a) * q, axis=1) / scale
        inside = np.minimum(np.minimum(u, v), 1 - u - v)
        hit[i] = np.any((inside >= 0) & (t > 0))
        doubtful[i] = np.any((np.abs(inside) < 1e-5) & (t > 0))
    return hit, doubtful
