"""The sizes that a partition probe is printed to."""

import math
from dataclasses import dataclass

from skylight.errors import InputError

NOZZLE_MM = 0.4  # the common one
# of a face's free radius: how far round its centre captures look at it
SEEN_DISC = 0.75
_LEAST_SHELL_MM = 5.0  # from the kernel's faces to the outside


@dataclass(frozen=True, kw_only=True)
class ProbeSizes:
    """Diameter of the shell, distance of the kernel's faces from its centre, and fits; mm.

    ``wall_mm`` is the thickness of the walls between cells, ``clearance_mm`` the gap per side
    between parts that meet. ``flare``: walls grow thicker outwards, from 0, not at all, to 1, as
    far as hides nothing of a cell's light from a disc of ``SEEN_DISC`` of its face's free radius
    (:func:`~skylight.probes.partitions.printed.walls.rim_halves`).
    """

    outer_mm: float = 80.0
    kernel_mm: float = 8.0
    wall_mm: float = 1.6
    clearance_mm: float = 0.15
    flare: float = 0.0  # of probes whose files do not say

    def __post_init__(self) -> None:
        for name in ("outer_mm", "kernel_mm", "wall_mm", "clearance_mm"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"{name} must be a length above 0 mm, got {value:g}")
        if not 0 <= self.flare <= 1:
            raise InputError(f"flare must be 0 to 1, got {self.flare:g}")
        if self.clearance_mm >= self.wall_mm / 2:
            raise InputError(
                f"clearance_mm {self.clearance_mm:g} must be below half of wall_mm "
                f"{self.wall_mm:g}, or light passes below the walls; 0.1 to 0.3 suits most printers"
            )
        if self.wall_mm < 2 * NOZZLE_MM:
            raise InputError(
                f"walls of {self.wall_mm:g} mm are too thin to print: make wall_mm "
                f"{2 * NOZZLE_MM:g} or more (two lines of a {NOZZLE_MM:g} mm nozzle)"
            )
        if self.radius_mm < self.kernel_mm + _LEAST_SHELL_MM:
            raise InputError(
                f"a kernel with faces {self.kernel_mm:g} mm from its centre leaves no room for "
                f"walls in a shell of {self.outer_mm:g} mm: make outer_mm "
                f"{2 * (self.kernel_mm + _LEAST_SHELL_MM):g} or more, or the kernel smaller"
            )

    @property
    def radius_mm(self) -> float:
        """Of the shell."""
        return self.outer_mm / 2
