"""Measurements on the parts of a partition probe, as they stand when assembled."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from skylight.fabrication.checks import meets_on_its_way, overlap_mm3, part_figures, play_mm
from skylight.fabrication.part import PrintedPart
from skylight.fabrication.report import (
    FACE_TOLERANCE_MM,
    MeasuredParts,
    clearance_problems,
)
from skylight.probes.partitions.printed.halves import ProbeParts
from skylight.probes.partitions.printed.sizes import ProbeSizes

# two sides within 37 degrees of parallel make a wall, others an edge
OPPOSED_COS = 0.8
_FAR = 4.0  # clearances up to which play is looked for


@dataclass(frozen=True, kw_only=True)
class PartitionPrintReport(MeasuredParts):
    """Figures of all parts; ``problems`` is empty where all is well.

    ``kernel_play_mm``: how far the kernel moves in the closed shell along +-x, +-y, +-z;
    ``pin_play_mm``: how far the upper half does on its pins, at right angles to them;
    ``seam_mm``: how far it goes on down. ``face_deviation_mm``: the faces' centres from where they
    should be.
    """

    sizes: ProbeSizes
    kernel_play_mm: tuple[float, ...]
    pin_play_mm: tuple[float, ...]
    seam_mm: float

    @property
    def clearances_mm(self) -> tuple[float, float]:
        """(least, largest) of all that meets."""
        every = (*self.kernel_play_mm, *self.pin_play_mm, self.seam_mm)
        return min(every), max(every)

    @property
    def problems(self) -> tuple[str, ...]:
        """One line for each verdict that fails."""
        found = self._part_problems(self.sizes.wall_mm)
        plays = {
            "kernel in its shell": self.kernel_play_mm,
            "upper half on its pins": self.pin_play_mm,
            "upper half on the lower": (self.seam_mm,),
        }
        for name, play in plays.items():
            found += clearance_problems(name, play, self.sizes.clearance_mm)
        found += self._fit_problems()
        if not self.face_deviation_mm <= FACE_TOLERANCE_MM:
            found.append(f"faces are up to {self.face_deviation_mm:.3g} mm off their planes")
        return tuple(found)


def check_partition_parts(
    printed: ProbeParts, sizes: ProbeSizes, *, alone: Sequence[PrintedPart] = ()
) -> PartitionPrintReport:
    """Measure shells and kernel as they stand, and others ``alone``."""
    solids = [part.solid() for part in printed.parts]
    lower, kernel, upper = solids
    farthest = _FAR * sizes.clearance_mm
    way = printed.split.way_in
    across = np.cross(way, np.eye(3)[np.abs(way).argmin()])
    across /= np.linalg.norm(across)
    sideways = [across, np.cross(way, across)]
    axes = [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    shell = _joined(lower, upper)
    return PartitionPrintReport(
        sizes=sizes,
        parts=tuple(
            part_figures(part, opposed_cos=OPPOSED_COS) for part in (*printed.parts, *alone)
        ),
        kernel_play_mm=tuple(play_mm(shell, kernel, axis, farthest) for axis in axes),
        pin_play_mm=tuple(
            play_mm(lower, upper, sign * side, farthest) for side in sideways for sign in (1, -1)
        ),
        seam_mm=play_mm(lower, upper, -way, farthest),
        overlap_mm3=overlap_mm3(solids),
        blocked=_blocked(printed, solids, sizes),
        face_deviation_mm=_face_deviation_mm(printed, sizes),
    )


def _blocked(
    printed: ProbeParts, solids: Sequence[Manifold | None], sizes: ProbeSizes
) -> tuple[str, ...]:
    """Kernel, then upper half, brought in along the split's way."""
    return tuple(
        part.name
        for place, part in enumerate(printed.parts)
        if place
        and meets_on_its_way(solids[:place], solids[place], printed.split.way_in, sizes.wall_mm / 2)
    )


def _face_deviation_mm(printed: ProbeParts, sizes: ProbeSizes) -> float:
    """From the kernel's mesh: its reach along each face's normal against ``kernel_mm``."""
    reach = (printed.kernel.vertices @ printed.net.normals.T).max(0)
    return float(np.abs(reach - sizes.kernel_mm).max())


def _joined(lower: Manifold | None, upper: Manifold | None) -> Manifold | None:
    return None if lower is None or upper is None else lower + upper
