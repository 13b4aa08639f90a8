"""Missing slots from their globally illuminated transfer (thesis, section 3.4.4, Eq. 3.17)."""

from jaxtyping import Bool
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.voxel.faces import ORIENTATIONS
from skylight.probes.voxel.reconstruct import SlotReconstruction, combinations_of
from skylight.probes.voxel.transfer import slot_transfer

# Of the thesis' figures: with 0.8, the renderer's default, its errors come out to 5 %.
ALBEDO = 0.8
COST = 0.1


class GlobalReconstruction(SlotReconstruction):
    """From transfer vectors: ``argmin |tau_u - T^T x|^2 + cost |x|_0``.

    tau stacks the 16 x 16 texels' 25 coefficients of outgoing radiance, albedo included: |tau|^2
    of a free face is 34.7 for an albedo of 0.8. There, the thesis' cost of 1 gives errors larger
    than the thesis prints (5-probe: 0.0114 +- 0.0164); costs of 0.1 and less give those it prints.
    """

    def __init__(
        self, known: Bool[Tensor, "6 32"], *, albedo: float = ALBEDO, cost: float = COST
    ) -> None:
        if not cost >= 0:
            raise InputError(f"the cost of a slot must be 0 or more, got {cost}")
        # inner products are all that counts, and the orientations' rotations keep them
        rows = slot_transfer(albedo).flatten(1)
        rows = rows[None].expand(len(ORIENTATIONS), -1, -1)
        super().__init__(combinations_of(rows, known, cost=cost), known)
