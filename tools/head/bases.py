"""The mean head with its bases of identity, from sampled heads, and of expression."""

import numpy as np
import scipy.linalg

from tools.head.assets import ADULT_SCALE, DECIMETRE, Assets
from tools.head.cage import Cage


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
