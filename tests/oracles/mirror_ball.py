"""A mirror ball photographed in light given as a function of direction: ray by ray, in float64."""

import numpy as np


def photograph(light, *, size, focal_px, middle, distance, radius, backdrop, turn=None, samples=2):
    """Linear picture (h, w, 3) of a ball whose middle is seen at ``middle`` (px).

    The camera is at the origin, looks along -Z, +X is right, +Y up. ``light(w)`` and
    ``backdrop(w)`` give (n, 3) for unit directions (n, 3); ``backdrop`` is what is seen beside the
    ball, and ``turn`` (3, 3) takes the camera's directions to those that ``light`` knows. Each ray
    solves |t d - c|^2 = r^2 and leaves along d - 2 (d.n) n.
    """
    height, width = size
    centre = ray((middle[0], middle[1]), size, focal_px)
    centre = distance * centre / np.linalg.norm(centre)
    step = (np.arange(samples) + 0.5) / samples
    rows = (np.arange(height)[:, None] + step).ravel()
    columns = (np.arange(width)[:, None] + step).ravel()
    x, y = np.meshgrid(columns, rows)
    d = ray((x.ravel(), y.ravel()), size, focal_px).T
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    along = d @ centre
    inside = along**2 - (distance**2 - radius**2)
    hit = inside > 0
    t = along[hit] - np.sqrt(inside[hit])
    normal = (t[:, None] * d[hit] - centre) / radius
    mirrored = d[hit] - 2 * np.sum(d[hit] * normal, 1, keepdims=True) * normal
    if turn is None:
        turn = np.eye(3)
    colour = backdrop(d @ turn.T)
    colour[hit] = light(mirrored @ turn.T)
    shape = (height, samples, width, samples, 3)
    return colour.reshape(shape).mean((1, 3))


def ray(pixel, size, focal_px):
    x, y = pixel
    one = np.ones_like(np.asarray(x, dtype=float))
    return np.array([(x - size[1] / 2) / focal_px, (size[0] / 2 - y) / focal_px, -1 * one])
