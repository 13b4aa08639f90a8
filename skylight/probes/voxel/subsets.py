"""Sparse least squares with an L0 penalty, by exhaustive search over subsets."""

from itertools import combinations
from math import comb

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

EXHAUSTIVE = 14  # rows: 16,384 subsets
_LARGEST = 6  # terms, of more rows than that
_AT_ONCE = 20_000
_DEPENDENT = 1e-7  # of a row's power: what is left of it beside the others of a subset


def sparse_combinations(
    known: Float[Tensor, "m d"], wanted: Float[Tensor, "t d"], *, cost: float
) -> Float[Tensor, "t m"]:
    """``argmin_x |w - known^T x|^2 + cost |x|_0`` for each row w of ``wanted``.

    Every subset of linearly independent rows is solved for all of ``wanted`` at once; of up to
    :data:`EXHAUSTIVE` rows all subsets, of more all those of at most 6. The least objective wins,
    among equals (to 1e-9 of ``|w|^2``) the fewest terms, among those the smallest ``|x|``, which
    amplifies noise least. ``cost = 0`` is thus plain least squares with as few terms as reach it.
    """
    gram = (known @ known.T).double()
    right = (known @ wanted.T).double()  # (m, t)
    power = wanted.double().square().sum(1)
    count = len(known)
    largest = count if count <= EXHAUSTIVE else _LARGEST
    slack = 1e-9 * power.clamp(min=1e-300)
    best = power.clone()  # of no terms
    terms = torch.zeros(len(wanted))
    norms = torch.zeros(len(wanted), dtype=torch.float64)
    result = torch.zeros(len(wanted), count, dtype=torch.float64)
    for size in range(1, largest + 1):
        for subsets in _batches(count, size):
            solved, x = _solve(gram, right, subsets)
            subsets = subsets[solved]
            if not len(subsets):
                continue
            gain = (x * right[subsets]).sum(1)  # (s, t)
            objective = power - gain + cost * size
            norm = x.square().sum(1)
            least = objective.amin(0)
            # of those as good as the best, the smallest weights
            norm = torch.where(objective <= least + slack, norm, torch.inf)
            chosen = norm.argmin(0)
            each = torch.arange(len(wanted))
            better = (least < best - slack) | (
                (terms == size) & (least <= best + slack) & (norm[chosen, each] < norms)
            )
            for t in torch.nonzero(better)[:, 0].tolist():
                s = int(chosen[t])
                best[t], terms[t], norms[t] = objective[s, t], size, norm[s, t]
                result[t] = 0
                result[t, subsets[s]] = x[s, :, t]
    return result


def _batches(count: int, size: int):
    found = combinations(range(count), size)
    for _ in range(-(-comb(count, size) // _AT_ONCE)):
        some = [c for c, _ in zip(found, range(_AT_ONCE), strict=False)]
        yield torch.from_numpy(np.array(some, dtype=np.int64))


def _solve(
    gram: Float[Tensor, "m m"], right: Float[Tensor, "m t"], subsets: Tensor
) -> tuple[Tensor, Tensor]:
    """(which subsets are independent, their weights (s, size, t))."""
    blocks = gram[subsets[:, :, None], subsets[:, None, :]]
    factors, info = torch.linalg.cholesky_ex(blocks)
    lengths = blocks.diagonal(dim1=1, dim2=2).sqrt()
    pivots = factors.diagonal(dim1=1, dim2=2)
    solved = (info == 0) & (pivots > _DEPENDENT**0.5 * lengths).all(1)
    return solved, torch.cholesky_solve(right[subsets[solved]], factors[solved])
