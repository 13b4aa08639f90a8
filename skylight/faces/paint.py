"""Colours of random people, per vertex of the head model: skin of melanin and blood, lips, eyes."""

import math

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from skylight.faces.model import HeadModel, Region
from skylight.faces.skin import BLOOD_COLOUR, MELANIN_COLOUR

# Where skin is not skin: factors on its albedo, linear RGB (nominal).
_REGION_TINT: dict[Region, tuple[float, float, float]] = {
    Region.LIPS: (0.8, 0.55, 0.6),
    Region.BROW: (0.25, 0.22, 0.2),
    Region.MOUTH: (0.35, 0.2, 0.2),
}
_SCLERA, _IRIS = (0.62, 0.6, 0.57), (0.05, 0.035, 0.025)
# Size of patches in metres, and how much melanin and blood vary with them at most, in log green.
_PATCHES = ((0.05, 0.06, 0.05), (0.015, 0.04, 0.04), (0.004, 0.03, 0.02))


def paint(skin: Float[ndarray, "3"], rng: np.random.Generator) -> Float[ndarray, "n 3"]:
    """Albedo at each vertex of a person whose face has the geometric mean albedo ``skin``."""
    model = HeadModel.load()
    painted = skin * np.exp(-_absorbed(model, rng))
    for region, tint in _REGION_TINT.items():
        painted[model.regions == region] *= np.array(tint)
    eyes = np.flatnonzero(model.regions == Region.EYEBALL)
    front = model.mean[eyes, 2] > np.quantile(model.mean[eyes, 2], 0.8)
    painted[eyes] = np.where(front[:, None], np.array(_IRIS), np.array(_SCLERA))
    return painted.clip(0.001, 0.95)


def _absorbed(model: HeadModel, rng: np.random.Generator) -> Float[ndarray, "n 3"]:
    """How much darker skin is than the mean of the face, in log albedo.

    People differ in how much their skin varies, and in what: patches of three sizes, redder cheeks,
    nose, chin and ears, a jaw with the shadow of a beard or paler than a tanned forehead, dark
    rings under the eyes. None of it is made of the modes that estimates solve for.
    """
    where, marks = model.mean, model.landmarks(model.mean)
    melanin, blood = np.zeros(len(where)), np.zeros(len(where))
    for patch_m, most_melanin, most_blood in _PATCHES:
        melanin += rng.uniform(0.2, 1) * most_melanin * field(where, patch_m, rng)
        blood += rng.uniform(0.2, 1) * most_blood * field(where, patch_m, rng)
    flushed = rng.uniform(0, 1) * np.array([0.25, 0.3, 0.15, 0.25])
    cheeks = spots(where, marks[[2, 31, 41]].mean(0), 0.018) + spots(
        where, marks[[14, 35, 46]].mean(0), 0.018
    )
    nose, chin = spots(where, marks[30], 0.012), spots(where, marks[8], 0.015)
    blood += flushed @ np.stack([cheeks, nose, chin, model.regions == Region.EAR])
    rings = sum(spots(where, marks[i] - [0, 0.008, 0], 0.008) for i in (40, 41, 46, 47))
    melanin += rng.uniform(0, 0.15) * np.minimum(rings, 1)
    # from -1 at the chin to 1 at the hairline
    height = ((where[:, 1] - marks[33, 1]) / 0.05).clip(-1, 1)
    melanin += rng.normal(0, 0.05) * height
    if rng.random() < 0.3:  # of a shaved beard
        melanin += rng.uniform(0.05, 0.2) * (-height).clip(0, 1)
    # pigment in dark skin is nearly grey, in light skin it takes mostly blue
    strength = rng.uniform(0.3, 1.4)
    colours = np.stack([np.array(MELANIN_COLOUR) ** strength, BLOOD_COLOUR])
    amounts = np.stack([melanin, blood], 1)
    amounts -= amounts[model.regions == Region.FACE].mean(0)
    return amounts @ colours


def field(
    points: Float[ndarray, "m 3"], patch_m: float, rng: np.random.Generator
) -> Float[ndarray, " m"]:
    """A smooth random field of variance 1: 32 waves whose lengths are about 2 ``patch_m``."""
    waves = rng.normal(0, math.pi / patch_m / math.sqrt(3), (32, 3))
    phase = rng.uniform(0, 2 * math.pi, 32)
    return np.cos(points @ waves.T + phase).sum(1) * math.sqrt(2 / 32)


def spots(
    points: Float[ndarray, "m 3"], centre: Float[ndarray, "3"], width_m: float
) -> Float[ndarray, " m"]:
    """A Gaussian of height 1 about ``centre``."""
    return np.exp(-((points - centre) ** 2).sum(1) / (2 * width_m**2))
