"""Dimensions of a printed probe."""

import math
from dataclasses import dataclass

from skylight.errors import InputError


@dataclass(frozen=True, kw_only=True)
class PrintSizes:
    """Side of a voxel face, thickness of all walls, and gap per side of what slides together; mm.

    A collar of one part plugs ``collar_mm`` deep into the open side of the next.
    """

    face_mm: float = 20.0
    wall_mm: float = 1.6
    clearance_mm: float = 0.15

    def __post_init__(self) -> None:
        for name in ("face_mm", "wall_mm", "clearance_mm"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"{name} must be a length above 0 mm, got {value:g}")
        if self.clearance_mm >= self.wall_mm:
            raise InputError(
                f"clearance_mm {self.clearance_mm:g} must be below wall_mm {self.wall_mm:g}, or "
                "the parts fall through one another; 0.1 to 0.3 suits most printers"
            )
        least = 6 * self.wall_mm + 4 * self.clearance_mm
        if self.face_mm < least - 1e-9:
            enough = math.ceil(10 * least - 1e-6) / 10
            raise InputError(
                f"walls of {self.wall_mm:g} mm leave no room for a joint in a face of "
                f"{self.face_mm:g} mm: make the face {enough:g} mm or more (6 walls and "
                "4 clearances), or the walls thinner"
            )

    @property
    def collar_mm(self) -> float:
        """How deep collars go: a quarter of the face."""
        return self.face_mm / 4

    @property
    def frame_mm(self) -> float:
        """Width of the frame that is left of a side which the next part covers.

        A wall, the gap, the collar's wall, and one clearance for what neighbours may be inset.
        """
        return 2 * self.wall_mm + 2 * self.clearance_mm
