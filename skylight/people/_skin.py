"""A head's surface for rendering: a finer mesh and its textures.

Skin is of melanin and blood; lips, stubble and eyes have colours of their own. The mesh is the head
model's, subdivided; the model's own vertices stay the ground truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import KDTree

from skylight.faces._landmarks import shipped_arrays
from skylight.faces._model import HeadModel, Region
from skylight.faces._synthetic import field, spots
from skylight.transport._render import vertex_normals


@dataclass(frozen=True, kw_only=True)
class SmoothHead:
    """Every triangle in four: the n vertices of the model, then one per edge.

    ``belongs`` (r, m) is how far each of the m vertices belongs to each :class:`Region`;
    ``neutral`` the mean head, on which people are painted.
    """

    edges: Int[ndarray, "e 2"]
    faces: Int[ndarray, "f 3"]
    belongs: Float[ndarray, "r m"]
    neutral: Float[ndarray, "m 3"]

    @staticmethod
    @cache
    def load() -> SmoothHead:
        """Of the shipped head model; made once."""
        model = HeadModel.load()
        a, b, c = model.faces.T
        sides = np.sort(np.stack([model.faces, np.roll(model.faces, -1, 1)], -1), -1)
        edges, of_side = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
        ab, bc, ca = of_side.reshape(-1, 3).T + len(model.mean)
        faces = np.stack([a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca], 1).reshape(-1, 3)
        one_hot = (model.regions[None] == np.array(list(Region))[:, None]).astype(float)
        return SmoothHead(
            edges=edges,
            faces=faces,
            belongs=np.concatenate([one_hot, one_hot[:, edges].mean(-1)], 1),
            neutral=rounded(model.mean, model.faces, edges),
        )

    def points(self, vertices: Float[ndarray, "n 3"]) -> Float[ndarray, "m 3"]:
        """The finer head that goes through the model's ``vertices``."""
        return rounded(vertices, HeadModel.load().faces, self.edges)


def rounded(
    vertices: Float[ndarray, "n 3"], faces: Int[ndarray, "f 3"], edges: Int[ndarray, "e 2"]
) -> Float[ndarray, "m 3"]:
    """The vertices, then a point over the middle p of each edge, on the smooth surface.

    p - 1/4 sum_i <p - v_i, n_i> n_i over both ends: half way to the ends' tangent planes (Boubekeur
    & Alexa 2008, "Phong Tessellation"), which on a sphere is right to second order.
    """
    normals = normals_of(vertices, faces)
    ends, upright = vertices[edges], normals[edges]
    middle = ends.mean(1)
    above = ((middle[:, None] - ends) * upright).sum(-1, keepdims=True)
    return np.concatenate([vertices, middle - 0.25 * (above * upright).sum(1)])


def normals_of(
    vertices: Float[ndarray, "n 3"], faces: Int[ndarray, "f 3"]
) -> Float[ndarray, "n 3"]:
    """Unit vertex normals."""
    return vertex_normals(
        torch.from_numpy(np.array(vertices)), torch.from_numpy(np.array(faces))
    ).numpy()


CLUSTERS = 6
# Volume fraction of melanosomes in the epidermis of the lightest and the darkest cluster; those
# between are even steps of its logarithm, and people vary by up to half a step.
LIGHTEST, DARKEST = 0.012, 0.42
_STEP = math.log(DARKEST / LIGHTEST) / (CLUSTERS - 1)
_BLOOD = (0.008, 0.035)  # volume fraction in the dermis, from person to person
_LIGHT_HAIR, _DARK_HAIR = np.array([0.30, 0.19, 0.09]), np.array([0.018, 0.014, 0.011])
_GUM, _TEETH = np.array([0.28, 0.09, 0.08]), np.array([0.55, 0.48, 0.38])
_SCLERA, _PUPIL = np.array([0.62, 0.58, 0.54]), np.array([0.004, 0.004, 0.004])
_IRISES = np.array(
    [[0.05, 0.025, 0.012], [0.09, 0.055, 0.02], [0.10, 0.16, 0.22], [0.1, 0.13, 0.07]]
)
_IRIS_M, _PUPIL_M = 0.0062, 0.0024


@dataclass(frozen=True, kw_only=True)
class Paint:
    """Per vertex of the smooth head: diffuse albedo, linear Rec.709, and roughness (sqrt alpha)."""

    albedo: Float[ndarray, "m 3"]
    roughness: Float[ndarray, " m"]
    hair: Float[ndarray, 3]


@cache
def skin_colour() -> RegularGridInterpolator:
    """(log melanin, log blood) -> log albedo, from ``tools/build_skin_spectra.py``'s table."""
    names = "melanin", "blood", "albedo"
    stored = shipped_arrays("skylight.people", "skin_colours.npz", *names)
    melanin, blood, albedo = (np.log(stored[name]) for name in names)
    return RegularGridInterpolator((melanin, blood), albedo)


def skin_albedo(
    melanin: Float[ndarray, " m"], blood: Float[ndarray, " m"]
) -> Float[ndarray, "m 3"]:
    """Diffuse albedo of skin with these volume fractions, held within the table."""
    table = skin_colour()
    amounts = np.stack([np.log(melanin), np.log(blood)], -1)
    low, high = (np.array([pick(axis) for axis in table.grid]) for pick in (np.min, np.max))
    return np.exp(table(amounts.clip(low, high)))


def paint(cluster: int, rng: np.random.Generator) -> Paint:
    """A random person's colours in one of :data:`CLUSTERS` tones, 0 the lightest.

    Melanin and blood vary over the face as smooth random fields (patches of 5 cm, 15 mm and 4 mm);
    cheeks, nose, ears and lips have more blood, the skin under the eyes more melanin.
    """
    head, model = SmoothHead.load(), HeadModel.load()
    where, marks = head.neutral, model.landmarks(model.mean)
    tone = math.log(LIGHTEST) + _STEP * (cluster + rng.uniform(-0.5, 0.5) * 0.9)
    melanin = np.full(len(where), tone)
    blood = np.full(len(where), rng.uniform(*np.log(_BLOOD)))
    for patch_m, melanin_share, blood_share in (
        (0.05, 0.06, 0.10),
        (0.015, 0.05, 0.08),
        (0.004, 0.06, 0.05),
    ):
        melanin += melanin_share * field(where, patch_m, rng)
        blood += blood_share * field(where, patch_m, rng)

    cheeks = spots(where, marks[[2, 31, 41]].mean(0), 0.018) + spots(
        where, marks[[14, 35, 46]].mean(0), 0.018
    )
    nose = spots(where, marks[30], 0.012)
    under_eyes = sum(spots(where, marks[i] - [0, 0.008, 0], 0.008) for i in (40, 41, 46, 47))
    blood += rng.uniform(0.1, 0.7) * cheeks + rng.uniform(0.2, 0.8) * nose
    blood += 0.4 * head.belongs[Region.EAR] + 0.6 * head.belongs[Region.HIDDEN]
    melanin += rng.uniform(0, 0.4) * np.minimum(under_eyes, 1)
    melanin += 0.1 * field(where, 0.08, rng) * (where[:, 1] > marks[27, 1])
    lips = head.belongs[Region.LIPS]
    blood += rng.uniform(1.0, 1.8) * lips
    melanin += 0.15 * lips
    if rng.random() < 0.4:
        melanin += freckles(where, marks, rng) * rng.uniform(0.3, 0.9)
    albedo = skin_albedo(np.exp(melanin), np.exp(blood))

    hair = _hair_colour(cluster, rng)
    if rng.random() < 0.4:
        cover = stubble(where, marks) * (1 - lips) * rng.uniform(0.15, 0.5)
        cover = cover * (1 + 0.3 * field(where, 0.003, rng)).clip(0, 2)
        albedo = mix(albedo, 0.6 * hair + 0.02, cover)
    brow = head.belongs[Region.BROW] * ((np.abs(where[:, 0]) - 0.008) / 0.01).clip(0, 1)
    brow = brow * (1 + 0.15 * field(where, 0.004, rng))
    albedo = mix(albedo, hair, rng.uniform(0.35, 0.75) * brow)
    mouth, teeth = head.belongs[Region.MOUTH], _teeth(model, head)
    albedo = mix(mix(albedo, _GUM * (1 - 0.4 * cluster / CLUSTERS), mouth), _TEETH, teeth)
    albedo = mix(albedo, albedo * [0.75, 0.6, 0.6], head.belongs[Region.HIDDEN])
    _paint_eyes(albedo, model, head, rng)

    rough = np.full(len(where), rng.uniform(0.42, 0.58)) + 0.02 * field(where, 0.02, rng)
    forehead = spots(where, marks[27] + [0, 0.045, 0.01], 0.03)
    rough -= rng.uniform(0, 0.1) * np.maximum(nose, forehead) + 0.08 * lips
    return Paint(albedo=albedo.clip(0.003, 0.9), roughness=rough.clip(0.25, 0.7), hair=hair)


def freckles(
    points: Float[ndarray, "m 3"], marks: Float[ndarray, "68 3"], rng: np.random.Generator
) -> Float[ndarray, " m"]:
    """Spots of about 1 to 2 mm, most of them over nose and cheeks; up to about 1."""
    middle = marks[29]
    weight = np.exp(-(((points - middle) / [0.045, 0.022, 0.04]) ** 2).sum(1) / 2)
    chosen = rng.choice(len(points), int(rng.integers(60, 260)), p=weight / weight.sum())
    distance, nearest = KDTree(points[chosen]).query(points)
    width = rng.uniform(0.0008, 0.0018, len(chosen))[nearest]
    return np.exp(-((distance / width) ** 2) / 2)


def stubble(points: Float[ndarray, "m 3"], marks: Float[ndarray, "68 3"]) -> Float[ndarray, " m"]:
    """1 over jaw, chin and upper lip, falling off within 2 cm; 0 above the nose."""
    distance, _ = KDTree(marks[[*range(3, 14), 33, *range(48, 60)]]).query(points)
    below = ((marks[33, 1] + 0.004 - points[:, 1]) / 0.012).clip(0, 1)
    return np.exp(-((distance / 0.018) ** 2)) * below


def mix(
    albedo: Float[ndarray, "m 3"], other: Float[ndarray, "*#m 3"], share: Float[ndarray, " m"]
) -> Float[ndarray, "m 3"]:
    """(1 - share) albedo + share other."""
    share = share.clip(0, 1)[:, None]
    return (1 - share) * albedo + share * other


def _hair_colour(cluster: int, rng: np.random.Generator) -> Float[ndarray, 3]:
    dark = min(1.0, rng.beta(2, 1.2) + 0.25 * cluster)
    return np.exp((1 - dark) * np.log(_LIGHT_HAIR) + dark * np.log(_DARK_HAIR))


def _teeth(model: HeadModel, head: SmoothHead) -> Float[ndarray, " m"]:
    """1 on the parts of the mouth that hang together with no skin."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    joined = coo_matrix((np.ones(len(head.edges)), head.edges.T), shape=(len(model.mean),) * 2)
    _, part = connected_components(joined)
    other = np.unique(part[model.regions != Region.MOUTH])
    own = (~np.isin(part, other)).astype(float)
    return np.concatenate([own, own[head.edges].mean(-1)])


def _paint_eyes(
    albedo: Float[ndarray, "m 3"], model: HeadModel, head: SmoothHead, rng: np.random.Generator
) -> None:
    """Pupil, iris and sclera, by the distance from each eye's axis, in place."""
    iris = _IRISES[rng.choice(len(_IRISES), p=[0.55, 0.2, 0.15, 0.1])]
    eye = head.belongs[Region.EYEBALL] > 0.5
    for side in (-1, 1):
        here = eye & (side * head.neutral[:, 0] > 0)
        centre = (head.neutral[here].max(0) + head.neutral[here].min(0)) / 2
        distance = np.hypot(*(head.neutral[here, :2] - centre[:2]).T)
        colour = np.where((distance < _IRIS_M)[:, None], iris, _SCLERA)
        colour[distance < _PUPIL_M] = _PUPIL
        colour[head.neutral[here, 2] < centre[2]] = _SCLERA
        albedo[here] = colour
