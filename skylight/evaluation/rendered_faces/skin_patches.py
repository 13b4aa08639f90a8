"""The skin's surface as small patches, in the picture and round the corner."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial import KDTree

from skylight.evaluation.rendered_faces.people import Person, Seen, outer_skin
from skylight.evaluation.rendered_faces.smooth_head import SmoothHead


@dataclass(frozen=True, kw_only=True)
class SkinPatches:
    """k triangles: ``of_face`` of the head, between ``corners`` in its barycentric coordinates.

    ``positions`` are their middles, ``areas`` in the square of the positions' unit. ``pixel`` is
    the one, row by row, that shows it, or -1.
    """

    of_face: Int[ndarray, " k"]
    corners: Float[ndarray, "k 3 3"]
    positions: Float[ndarray, "k 3"]
    areas: Float[ndarray, " k"]
    pixel: Int[ndarray, " k"]


def patches(
    points: Float[ndarray, "m 3"],
    faces: Int[ndarray, "f 3"],
    chosen: Int[ndarray, " c"],
    area: float,
) -> SkinPatches:
    """The ``chosen`` faces, each in n^2 alike triangles of about ``area``; whole ones if smaller.

    They cover the faces without overlap, so their areas sum to the faces'.
    """
    corners = points[faces[chosen]]
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    whole = np.linalg.norm(sides, axis=1) / 2
    parts = np.maximum(1, np.rint(np.sqrt(whole / area))).astype(int)
    of_face, places, areas = [], [], []
    for n in np.unique(parts).tolist():
        here = np.flatnonzero(parts == n)
        inner = _divided(n)
        of_face.append(np.repeat(here, n * n))
        places.append(np.tile(inner, (len(here), 1, 1)))
        areas.append(np.repeat(whole[here] / n**2, n * n))
    owner, inside = np.concatenate(of_face), np.concatenate(places)
    return SkinPatches(
        of_face=chosen[owner],
        corners=inside,
        positions=np.einsum("kc,kcx->kx", inside.mean(1), corners[owner]),
        areas=np.concatenate(areas),
        pixel=np.full(len(owner), -1),
    )


def patches_in_reach(person: Person, seen: Seen, reach_m: float) -> SkinPatches:
    """Patches as large as a pixel, of all outer skin within ``reach_m`` of what the camera sees.

    A pixel shows a patch whose middle is less than its own width from the pixel's, so at a slant
    of more than about 60 degrees few are shown.
    """
    head = SmoothHead.load()
    skin, width = seen.positions[seen.skin], seen.pixel_m(person.truth.camera)
    corners = person.points[head.faces]
    middles = corners.mean(1)
    around = np.linalg.norm(corners - middles[:, None], axis=2).max(1)
    tree = KDTree(skin)
    near = tree.query(middles)[0] < reach_m + around
    chosen = np.flatnonzero(near & outer_skin()[head.faces].all(1))
    found = patches(person.points, head.faces, chosen, width**2)
    distance, nearest = tree.query(found.positions)
    kept = distance < reach_m
    shown = np.where(distance < width, np.flatnonzero(seen.skin)[nearest], -1)
    return SkinPatches(
        of_face=found.of_face[kept],
        corners=found.corners[kept],
        positions=found.positions[kept],
        areas=found.areas[kept],
        pixel=shown[kept],
    )


def _divided(n: int) -> Float[ndarray, "k 3 3"]:
    """Barycentric corners of the n^2 triangles that lines parallel to the sides make."""
    upright = [[(i, j), (i + 1, j), (i, j + 1)] for i in range(n) for j in range(n - i)]
    turned = [[(i + 1, j + 1), (i, j + 1), (i + 1, j)] for i in range(n) for j in range(n - i - 1)]
    second = np.array(upright + turned) / n
    return np.concatenate([1 - second.sum(-1, keepdims=True), second], -1)
