"""Subsurface scattering: diffusion of irradiance over the skin's surface.

What leaves a place x diffusely is albedo(x) times the integral of R(r) E(y) over all places y of
the skin, r from x, with the normalised diffusion of Christensen & Burley 2015 ("Approximate
Reflectance Profiles for Efficient Subsurface Scattering", Pixar Technical Memo 15-04)::

    R(r) = (exp(-r / d) + exp(-r / (3 d))) / (8 pi d r)

whose integral over a plane is 1, and that within r is P(r) = 1 - exp(-r/d) / 4 - 3 exp(-r/3d) / 4.
d is the diffuse mean free path over s = 3.5 + 100 (A - 0.33)^4, where A is the albedo of the
measured skin. Distances are straight lines, as with dipoles: light also passes through an ear. The
integral is a sum over small patches of the skin, those in the picture and those round the corner.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial import KDTree

from skylight.people._people import Person, Seen, outer_skin
from skylight.people._skin import SmoothHead


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


# "Skin 1" of Jensen, Marschner, Levoy & Hanrahan 2001 ("A Practical Model for Subsurface Light
# Transport", figure 5), red, green and blue, per mm: reduced scattering and absorption.
_SCATTERING, _ABSORPTION = np.array([0.74, 0.88, 1.01]), np.array([0.032, 0.17, 0.48])
_ALBEDO = np.array([0.44, 0.22, 0.13])
DIFFUSE_MEAN_FREE_PATH_MM = 1 / np.sqrt(3 * _ABSORPTION * (_ABSORPTION + _SCATTERING))
D_MM = DIFFUSE_MEAN_FREE_PATH_MM / (3.5 + 100 * (_ALBEDO - 0.33) ** 4)

REACH_MM = 10.0  # 3 % of red go further; they are taken to leave where they entered
_NEAR_MM = 5.0  # beyond that, patches count in clusters
_CLUSTER_MM = 3.0
_BLOCK = 4096  # pixels at a time


def profile(r_mm: Float[ndarray, " n"]) -> Float[ndarray, "n 3"]:
    """R(r), per mm^2, for r > 0."""
    r = r_mm[:, None]
    return (np.exp(-r / D_MM) + np.exp(-r / (3 * D_MM))) / (8 * math.pi * D_MM * r)


def scattered(
    irradiance: Float[ndarray, "n 3"],
    positions_m: Float[ndarray, "n 3"],
    pixel_mm: float,
    patches: SkinPatches,
    entering: Float[ndarray, "k 3"],
) -> Float[ndarray, "n 3"]:
    """E_i + sum_j w_ij (E_j - E_i) / max(1, sum_j w_ij), of pixels i and patches j of skin.

    w_ij = a_j R(r_ij) f(r_ij), where f is the part of one pixel's disc, of radius rho, that lies
    outside another r away (the lens formula): what leaves within a pixel stays in it, for flat
    skin exactly. Even light therefore stays even, and nothing gets brighter than what lights it:
    where more skin is in reach than a plane's, as in a fold, the weights are scaled to sum to 1. A
    plane keeps its power to 1 %. Patches beyond 5 mm count as clusters of 3 mm, which changes no
    pixel by more than 1 % of the light's range.
    """
    rho = pixel_mm / math.sqrt(math.pi)
    clusters = _clustered(1000 * patches.positions, 1e6 * patches.areas, entering)
    out = np.empty(irradiance.shape)
    for first in range(0, len(out), _BLOCK):
        here = slice(first, first + _BLOCK)
        own = irradiance[here]
        moved, weights = np.zeros(own.shape), np.zeros(own.shape)
        for pixel, distance, area, light in _pairs(1000 * positions_m[here], clusters):
            weight = area[:, None] * _outside(distance, rho)
            for c in range(3):
                weights[:, c] += np.bincount(pixel, weight[:, c], len(own))
                moved[:, c] += np.bincount(pixel, weight[:, c] * light[:, c], len(own))
        out[here] = own + (moved - weights * own) / np.maximum(1, weights)
    return out


@dataclass(frozen=True)
class _Patches:
    """Patches, millimetres, and their clusters: cluster c is patches ``first[c]`` on, so many.

    ``areas_of`` and ``light_of`` are the clusters'; ``tree`` holds their mean places.
    """

    places: Float[ndarray, "k 3"]
    areas: Float[ndarray, " k"]
    light: Float[ndarray, "k 3"]
    first: Int[ndarray, " g"]
    count: Int[ndarray, " g"]
    areas_of: Float[ndarray, " g"]
    light_of: Float[ndarray, "g 3"]
    tree: KDTree


def _clustered(
    places: Float[ndarray, "k 3"], areas: Float[ndarray, " k"], light: Float[ndarray, "k 3"]
) -> _Patches:
    """In the order of the cubes of 3 mm that they lie in."""
    cubes = np.floor(places / _CLUSTER_MM).astype(int)
    _, cube, count = np.unique(cubes, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(cube.ravel(), kind="stable")
    first = np.cumsum(count) - count
    places, areas, light = places[order], areas[order], light[order]
    areas_of = np.add.reduceat(areas, first)
    weighted = areas[:, None] * np.concatenate([places, light], 1)
    mean = np.add.reduceat(weighted, first) / areas_of[:, None]
    return _Patches(places, areas, light, first, count, areas_of, mean[:, 3:], KDTree(mean[:, :3]))


def _pairs(
    pixels: Float[ndarray, "n 3"], near: _Patches
) -> Iterator[tuple[ndarray, ndarray, ndarray, ndarray]]:
    """(pixel, distance, area, light) of all pairs: clusters as one patch, then single ones."""
    pair = KDTree(pixels).sparse_distance_matrix(near.tree, REACH_MM, output_type="ndarray")
    pixel, cluster = pair["i"], pair["j"]
    far = pair["v"] >= _NEAR_MM
    yield pixel[far], pair["v"][far], near.areas_of[cluster[far]], near.light_of[cluster[far]]
    pixel, cluster = pixel[~far], cluster[~far]
    many = near.count[cluster]
    within = np.arange(many.sum()) - np.repeat(np.cumsum(many) - many, many)
    pixel, patch = np.repeat(pixel, many), np.repeat(near.first[cluster], many) + within
    distance = np.linalg.norm(pixels[pixel] - near.places[patch], axis=1)
    yield pixel, distance, near.areas[patch], near.light[patch]


def _outside(distance: Float[ndarray, " p"], rho: float) -> Float[ndarray, "p 3"]:
    """R(r) times the part of a disc of radius ``rho`` outside another; its limit at 0."""
    half = (distance / (2 * rho)).clip(1e-6, 1)
    part = 1 - 2 / math.pi * (np.arccos(half) - half * np.sqrt(1 - half**2))
    return part[:, None] * profile(np.maximum(distance, 2e-6 * rho))
