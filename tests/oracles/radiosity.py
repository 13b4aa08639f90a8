"""Radiosity of a cube's sides by brute force: square patches, midpoint form factors, float64."""

import numpy as np


def corner_radiance(albedo, patches, sub=4):
    """(centres (p, 2), radiance (p,)) of a unit square with a unit wall on its edge x = 0.

    Light of radiance 1 comes from everywhere. L = albedo (1 - F 1 + F L), where F between patches
    is the mean of cos cos' area / (pi r^2) over sub x sub parts of the sending patch.
    """
    ticks = (np.arange(patches) + 0.5) / patches
    parts = (np.arange(patches * sub) + 0.5) / (patches * sub)
    x, y = (a.ravel() for a in np.meshgrid(ticks, ticks, indexing="ij"))
    z, t = (a.ravel() for a in np.meshgrid(parts, parts, indexing="ij"))
    # floor (x, y, 0) to wall (0, t, z): cosines z / r and x / r
    square = x[:, None] ** 2 + (y[:, None] - t) ** 2 + z**2
    kernel = x[:, None] * z / (np.pi * square**2) / (patches * sub) ** 2
    blocks = kernel.reshape(len(x), patches, sub, patches, sub).sum((2, 4)).reshape(len(x), -1)
    # by symmetry the wall sees the floor as the floor sees the wall, and they shine alike
    system = np.eye(len(x)) - albedo * blocks
    radiance = np.linalg.solve(system, albedo * (1 - blocks.sum(1)))
    return np.stack([x, y], 1), radiance
