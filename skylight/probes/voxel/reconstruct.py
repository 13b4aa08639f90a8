"""Reconstruction of missing lightmap slots as linear combinations of captured ones."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from skylight.errors import InputError
from skylight.probes.voxel.faces import (
    CONFIGURATIONS,
    OCCLUDERS,
    ORIENTATIONS,
    visibility_vectors,
)
from skylight.probes.voxel.lightmap import Lightmap
from skylight.probes.voxel.subsets import sparse_combinations


class SlotReconstruction(nn.Module):
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
