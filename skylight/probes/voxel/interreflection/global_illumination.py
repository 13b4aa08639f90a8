"""Reconstruction of missing slots by transfer with interreflection (thesis, 3.4.4, Eq. 3.17)."""

from jaxtyping import Bool
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.voxel.faces import ORIENTATIONS
from skylight.probes.voxel.interreflection.transfer import slot_transfer
from skylight.probes.voxel.reconstruct import SlotReconstruction, combinations_of

# Of the thesis' figures: with 0.8, the renderer's default, its errors come out to 5 %.
ALBEDO = 0.8
COST = 0.16  # at an albedo of 1


class GlobalReconstruction(SlotReconstruction):
    """From transfer vectors: ``argmin |tau_u - T^T x|^2 + cost |x|_0``.

    tau stacks the 16 x 16 texels' 25 coefficients of outgoing radiance, divided by the albedo so
    that a slot costs as much in dark material as in bright: ``|tau|^2`` of a free face is 54. With
    an albedo of 0.8, a cost of 1.6, which is the thesis' 1 for radiance, gives errors larger than
    the thesis prints (5-probe: 0.0114 +- 0.0164); costs of 0.16 and less give those it prints.
    """

    def __init__(
        self, known: Bool[Tensor, "6 32"], *, albedo: float = ALBEDO, cost: float = COST
    ) -> None:
        if not cost >= 0:
            raise InputError(f"the cost of a slot must be 0 or more, got {cost}")
        if not 0 < albedo <= 1:
            raise InputError(f"the probe's albedo must be above 0 and at most 1, got {albedo:g}")
        # inner products are all that counts, and the orientations' rotations keep them
        rows = slot_transfer(albedo).flatten(1) / albedo
        rows = rows[None].expand(len(ORIENTATIONS), -1, -1)
        super().__init__(combinations_of(rows, known, cost=cost), known)
