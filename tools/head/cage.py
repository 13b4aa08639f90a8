"""The part of MakeHuman's figure that is kept: head and neck, eyeballs and teeth."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tools.head.assets import Assets


def neutral(assets: Assets) -> np.ndarray:
    """MakeHuman's default young man (n, 3) dm: the figure used to choose vertices by position."""
    return (
        assets.vertices
        + assets.offsets("targets/macrodetails/caucasian-male-young")
        + assets.offsets("targets/macrodetails/universal-male-young-averagemuscle-averageweight")
    )


@dataclass(frozen=True)
class Cage:
    """The part of MakeHuman's mesh that is kept.

    ``keep`` (c,) original indices; ``quads`` (q, 4) over the kept vertices; ``mirror`` (c,) the
    vertex at the mirrored place; ``part`` (c,) 0 skin, 1 left eyeball, 2 right eyeball, 3 teeth.
    """

    keep: np.ndarray
    quads: np.ndarray
    mirror: np.ndarray
    part: np.ndarray


def cut_head(assets: Assets) -> Cage:
    """Head and neck of the body skin, with eyeballs and teeth."""
    x, y, z = neutral(assets).T
    # A plane falling towards the front of the neck (the nape ends higher than the throat) and
    # rising outwards, which leaves the shoulders out. Decimetres.
    above = y > 6.35 + 0.3 * (0.9 - z) + 0.35 * np.maximum(np.abs(x) - 0.5, 0.0)
    body = assets.groups["body"]
    near = np.abs(x) < 2.0  # raised above the plane only by its slope: hands and arms
    body = body[(above & near)[body].all(axis=1)]
    parts = [
        body,
        assets.groups["helper-l-eye"],
        assets.groups["helper-r-eye"],
        np.concatenate([assets.groups["helper-upper-teeth"], assets.groups["helper-lower-teeth"]]),
    ]
    quads = np.concatenate(parts)
    keep = np.unique(quads)
    number = np.full(len(assets.vertices), -1)
    number[keep] = np.arange(len(keep))
    part = np.zeros(len(keep), dtype=np.uint8)
    for label, group in enumerate(parts):
        part[number[np.unique(group)]] = label
    mirror = mirror_map(assets.vertices[keep], part)
    return Cage(keep, number[quads], mirror, part)


def mirror_map(vertices: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Index of each vertex's mirror image in x -> -x, exact on MakeHuman's base mesh."""
    swapped = np.array([0, 2, 1, 3])[part]  # a left eyeball mirrors onto the right one
    # The part label as a fourth coordinate keeps lids and eyeballs apart where they touch.
    tree = cKDTree(np.column_stack([vertices, 10.0 * part]))
    distance, index = tree.query(np.column_stack([vertices * [-1, 1, 1], 10.0 * swapped]))
    if distance.max() > 1e-3 or not (index[index] == np.arange(len(index))).all():
        raise SystemExit("the base mesh is not mirror symmetric")
    return index
