"""The skin's surface as small patches, in the picture and round the corner."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial import KDTree

from skylight.evaluation.rendered_faces.people import Person, Seen, no_skin
from skylight.evaluation.rendered_faces.smooth_head import SmoothHead


@dataclass(frozen=True, kw_only=True)
class SkinPatches:
    """k triangles: ``of_face`` of the head, between ``corners`` in its barycentric coordinates.

    ``positions`` are their middles, ``areas`` in the square of the positions' unit.
    """

    of_face: Int[ndarray, " k"]
    corners: Float[ndarray, "k 3 3"]
    positions: Float[ndarray, "k 3"]
    areas: Float[ndarray, " k"]

    def among(self, chosen) -> "SkinPatches":
        return SkinPatches(
            of_face=self.of_face[chosen],
            corners=self.corners[chosen],
            positions=self.positions[chosen],
            areas=self.areas[chosen],
        )


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
    for n in np.unique(parts):
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
    )


def patches_in_reach(person: Person, seen: Seen, reach_m: float) -> SkinPatches:
    """Patches as large as a pixel, of all skin within ``reach_m`` of skin that the camera sees."""
    head = SmoothHead.load()
    skin = seen.positions[seen.skin]
    pixel = float(np.median(-skin[:, 2])) / person.truth.camera.focal_px
    corners = person.points[head.faces]
    middles = corners.mean(1)
    around = np.linalg.norm(corners - middles[:, None], axis=2).max(1)
    tree = KDTree(skin)
    near = tree.query(middles)[0] < reach_m + around
    chosen = np.flatnonzero(near & ~no_skin()[head.faces].any(1))
    all_of_them = patches(person.points, head.faces, chosen, pixel**2)
    return all_of_them.among(tree.query(all_of_them.positions)[0] < reach_m)


def _divided(n: int) -> Float[ndarray, "k 3 3"]:
    """Barycentric corners of the n^2 triangles that lines parallel to the sides make."""
    upright = [[(i, j), (i + 1, j), (i, j + 1)] for i in range(n) for j in range(n - i)]
    turned = [[(i + 1, j + 1), (i, j + 1), (i + 1, j)] for i in range(n) for j in range(n - i - 1)]
    second = np.array(upright + turned) / n
    return np.concatenate([1 - second.sum(-1, keepdims=True), second], -1)
