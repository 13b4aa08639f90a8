"""Reconstruction of missing lightmap slots as linear combinations of captured ones.

The combinations are sparse: least squares with an L0 penalty, by exhaustive search over subsets.
"""

from dataclasses import replace
from itertools import combinations
from math import comb

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight._modes import on_cpu
from skylight._module import Module
from skylight.errors import InputError
from skylight.probes.voxel._lightmap import Lightmap
from skylight.probes.voxel._model import CONFIGURATIONS, OCCLUDERS, ORIENTATIONS, visibility_vectors

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


class SlotReconstruction(Module):
    """A missing slot as ``sum_j weights[o, i, j] slot[o, j]`` over the known of its orientation.

    ``weights`` (6,32,32), float64: rows of known slots are rows of the identity.
    """

    weights: Tensor
    known: Tensor

    def __init__(self, weights: Float[Tensor, "6 32 32"], known: Bool[Tensor, "6 32"]) -> None:
        super().__init__()
        self.register_buffer("weights", weights.double())
        self.register_buffer("known", known)

    def forward(self, radiance: Float[Tensor, "*b 6 32 n n c"]) -> Float[Tensor, "*b 6 32 n n c"]:
        """All slots from the known; what unknown ones hold does not matter if it is finite."""
        if radiance.shape[-5:-3] != self.known.shape:
            raise InputError(
                f"{type(self).__name__}'s slots of shape {tuple(radiance.shape)}: "
                "give (..., 6, 32, n, n, c)"
            )
        slots = radiance.flatten(-3)
        return (self.weights.to(slots.dtype) @ slots).reshape(radiance.shape)

    def complete(self, lightmap: Lightmap) -> Lightmap:
        """All 192 slots; light that comes out negative becomes 0."""
        absent = self.known & ~lightmap.known
        if bool(absent.any()):
            raise InputError(
                f"{int(absent.sum())} of the {int(self.known.sum())} slots that these weights need "
                f"were not captured, the first {first_slot(absent)}: make weights for the slots "
                "that were"
            )
        return replace(lightmap, radiance=self(lightmap.radiance).clamp(min=0))


class DirectReconstruction(SlotReconstruction):
    """By the visible parts of the hemisphere: exact for direct light.

    ``argmin |v_u - V^T x|^2``, and among its solutions the one of fewest slots (thesis, Eq. 3.11
    and 3.12): the visibility vectors V of the known slots are exactly what matters, so a
    combination that saves a slot for a larger residual is never worth it.
    """

    @on_cpu
    def __init__(self, known: Bool[Tensor, "6 32"]) -> None:
        vectors = visibility_vectors()
        rows = vectors[None].expand(len(ORIENTATIONS), -1, -1)
        super().__init__(combinations_of(rows, known, cost=0.0), known)


def combinations_of(
    rows: Float[Tensor, "6 32 d"], known: Bool[Tensor, "6 32"], *, cost: float
) -> Float[Tensor, "6 32 32"]:
    """Weights of :class:`SlotReconstruction` that match vectors of the slots."""
    if not bool(known.any(1).all()):
        none = [ORIENTATIONS[o] for o in torch.nonzero(~known.any(1))[:, 0].tolist()]
        raise InputError(f"no slot of orientation {', '.join(none)} is known: capture those sides")
    weights = torch.zeros(len(ORIENTATIONS), CONFIGURATIONS, CONFIGURATIONS, dtype=torch.float64)
    solved: dict[bytes, Tensor] = {}
    for o, (vectors, mask) in enumerate(zip(rows, known, strict=True)):
        # orientations of one and the same problem are solved once
        key = mask.numpy().tobytes() + vectors.contiguous().numpy().tobytes()
        if key not in solved:
            solved[key] = _completing(vectors, mask, cost)
        weights[o] = solved[key]
    return weights


def _completing(
    vectors: Float[Tensor, "32 d"], known: Bool[Tensor, " 32"], cost: float
) -> Float[Tensor, "32 32"]:
    have, want = torch.nonzero(known)[:, 0], torch.nonzero(~known)[:, 0]
    weights = torch.diag(known.double())
    if len(want):
        found = sparse_combinations(vectors[have], vectors[want], cost=cost)
        weights[want[:, None], have] = found
    return weights


def ranks(known: Bool[Tensor, "6 32"]) -> Int[Tensor, "6"]:
    """Of each orientation's visibility vectors: with 5 direct light is exact."""
    vectors = visibility_vectors()
    return torch.stack([torch.linalg.matrix_rank(vectors[mine]) for mine in known])


def first_slot(mask: Bool[Tensor, "6 32"]) -> str:
    """The first slot of a mask in words: "+x, occluders left, top"."""
    o, c = torch.nonzero(mask)[0].tolist()
    return f"{ORIENTATIONS[o]}, {occluders_in_words(c)}"


def occluders_in_words(configuration: int) -> str:
    present = [name for i, name in enumerate(OCCLUDERS) if configuration >> i & 1]
    return "occluded " + " and ".join(present) if present else "free"
