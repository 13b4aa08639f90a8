"""Shots of known rotations resampled to one lat-long map."""

import math
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import KDTree

from skylight.probes.panorama.lens import Lens
from skylight.probes.panorama.shots import Shot
from skylight.probes.radiance.probe_map import ProbeMap, averaged, finer_rows, latlong_directions
from skylight.sphere.envmap import EnvironmentMap
from skylight.work.progress import Progress

_MARGIN_PX = 1.0
_POWER = 3  # of the weight that falls from a shot's middle to its edges
# Weight of what is saturated in all exposures: it counts, as a bound, where nothing else is seen.
_SATURATED = 1e-4


def stitch(
    shots: Sequence[Shot],
    rotations: Mapping[int, Float[np.ndarray, "3 3"]],
    lens: Lens,
    height: int,
    progress: Progress = lambda share: None,
) -> ProbeMap:
    """The light round the camera on ``height`` rows, averaged down from a finer map.

    Each direction is the mean of the shots that show it, weighted by how far from a shot's edges
    it is and by how little of it is saturated,
    ``(1 - |2x/w - 1|)^3 (1 - |2y/h - 1|)^3 (1 - clipped)``.
    Vignetting is not undone: the edges of a lens that has much of it come out too dark, by less
    than the lens itself says, since edges count little where shots overlap. What no shot shows
    holds the nearest direction that one does.
    """
    fine = finer_rows(height, lens.focal_px)  # as dense as the middles of shots
    directions = latlong_directions(fine).numpy().reshape(-1, 3)
    # the density of the fine map's rows, so that a look-up between pixels leaves no light out
    scale = min(1.0, fine / math.pi / lens.focal_px)
    size = max(2, round(lens.width * scale)), max(2, round(lens.height * scale))
    small = lens.scaled(*size)
    light = np.zeros((len(directions), 4))
    weights = np.zeros(len(directions))
    limit = math.cos(min(small.half_diagonal_rad + 0.02, math.pi / 2))
    for done, (number, rotation) in enumerate(rotations.items()):
        progress(done / len(rotations))
        near = np.flatnonzero(directions @ -rotation[:, 2] > limit)
        rays = directions[near] @ rotation
        places = small.project(rays)
        inside = small.ahead(rays) & (places > _MARGIN_PX).all(1)
        inside &= (places < np.array(size) - _MARGIN_PX).all(1)
        near, places = near[inside], places[inside]
        seen = _look_up(shots[number], size, places)
        centred = 1 - np.abs(2 * places / np.array(size) - 1)
        weight = centred.prod(1) ** _POWER * (1 - seen[:, 3] + _SATURATED)
        light[near] += weight[:, None] * seen
        weights[near] += weight
    shown = weights > 0
    light[shown] /= weights[shown, None]
    layout = fine, 2 * fine
    return _filled(
        averaged(
            light[:, :3].reshape(*layout, 3),
            light[:, 3].reshape(layout),
            shown.reshape(layout),
            height,
        )
    )


def _look_up(
    shot: Shot, size: tuple[int, int], places: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 4"]:
    """Light and the share that is clipped, bilinear, of a shot scaled to ``size``."""
    values = np.dstack([shot.radiance, shot.clipped]).astype(np.float32)
    small = cv2.resize(values, size, interpolation=cv2.INTER_AREA)
    # remap takes pictures of fewer than 32768 columns and rows: places in blocks of rows
    blocks = np.array_split((places - 0.5).astype(np.float32), max(1, len(places) // 16384))
    found = [cv2.remap(small, b[:, :1], b[:, 1:], cv2.INTER_LINEAR)[:, 0] for b in blocks if len(b)]
    return np.concatenate([np.zeros((0, 4), np.float32), *found])


def _filled(probe: ProbeMap) -> ProbeMap:
    """Light of pixels that were seen in part is the mean of that part, of others the nearest's."""
    environment = probe.environment
    light, seen = environment.flat.numpy().copy(), probe.seen.numpy().ravel()
    clipped = probe.clipped.numpy().ravel().copy()
    shown = seen > 0
    light[shown] /= seen[shown, None]
    clipped[shown] /= seen[shown]
    directions = environment.grid.directions.numpy()
    if not shown.all():
        _, nearest = KDTree(directions[shown]).query(directions[~shown])
        light[~shown] = light[shown][nearest]
    return ProbeMap(
        environment=EnvironmentMap(
            radiance=torch.from_numpy(light).reshape(environment.radiance.shape)
        ),
        clipped=torch.from_numpy(clipped).reshape(probe.seen.shape),
        seen=probe.seen,
    )
