"""The sizes to which a design is printed where its user names none.

The kernel is the smallest that can be printed, since what a face sees of other cells grows with
its distance from the centre over the shell's radius, but with faces that a camera can read.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from skylight.errors import InputError
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.printed.halves import ShellPlan, standing_rotation
from skylight.probes.partitions.printed.sizes import NOZZLE_MM, ProbeSizes
from skylight.probes.partitions.printed.solids import WallNet, face_radii

FLARES = (1.0, 0.9, 0.8, 0.0)  # where none is named, the first with which nothing gets thin
BED_MM = 220.0  # side of the bed of most printers
_WALLS_MM = (1.6, 2 * NOZZLE_MM)  # the second where a probe were larger than the bed
_LEAST_OUTER_MM, _STEP_MM = 80.0, 10.0
_SHELL_TO_KERNEL = 10.0  # diameter of the shell to the distance of the kernel's faces, at least
_LEAST_KERNEL_MM, _MOST_KERNEL_MM, _FINEST_MM, _GROWTH = 4.0, 100.0, 0.1, 1.05
# across: the disc of half of it that is read has 12 pixels at 2 pixels for a mm
_READABLE_MM = 4.0


@dataclass(frozen=True, kw_only=True)
class AskedSizes:
    """What the user of a probe wants, None where its design decides; mm."""

    outer_mm: float | None = None
    kernel_mm: float | None = None
    wall_mm: float | None = None
    clearance_mm: float = 0.15
    flare: float | None = None

    def __post_init__(self) -> None:
        for name in ("outer_mm", "kernel_mm", "wall_mm"):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                raise InputError(f"{name} must be a length above 0 mm, got {value:g}")

    @property
    def free(self) -> bool:
        """Whether the design decides on all that it has to fit."""
        return self.outer_mm is None and self.kernel_mm is None and self.wall_mm is None


def fitted_sizes(
    cells: Cells, asked: AskedSizes, *, pole_mm: float, bed_mm: float = BED_MM
) -> ProbeSizes:
    """The smallest sizes to which a design can be printed, with what was asked for as it is.

    The kernel's distance is the least, of 4 mm or more, with which the shell can be made and cut.
    Where faces would have discs of less than 4 mm free, it grows up to a tenth of the shell's
    diameter. That is 80 mm, or ten times the least distance, in full 10 mm. Walls have 1.6 mm, or
    0.8 mm where the shell with its socket would be larger than the bed.

    Raises
    ------
    InputError
        What was asked for cannot be printed; the message names sizes that can be.
    """
    if not (math.isfinite(bed_mm) and bed_mm > 0):
        raise InputError(f"bed_mm must be a length above 0 mm, got {bed_mm:g}")
    net = WallNet.of(cells, standing_rotation(cells))
    walls = _WALLS_MM if asked.wall_mm is None else (asked.wall_mm,)
    found: list[ProbeSizes] = []
    reasons: list[InputError] = []
    for wall_mm in walls:
        try:
            sizes = _smallest(net, replace(asked, wall_mm=wall_mm), pole_mm)
        except InputError as error:
            reasons.append(error)
            continue
        if sizes.outer_mm + 2 * pole_mm <= bed_mm:
            return sizes
        found.append(sizes)
    if found:
        return min(found, key=lambda sizes: sizes.outer_mm)
    if asked.free:
        raise reasons[0]
    free = AskedSizes(clearance_mm=asked.clearance_mm, flare=asked.flare)
    good = fitted_sizes(cells, free, pole_mm=pole_mm, bed_mm=bed_mm)
    raise InputError(
        f"{reasons[0]}; this design prints with outer_mm {good.outer_mm:g}, kernel_mm "
        f"{good.kernel_mm:g} and wall_mm {good.wall_mm:g}"
    ) from reasons[0]


def _smallest(net: WallNet, asked: AskedSizes, pole_mm: float) -> ProbeSizes:
    """With the walls that were asked for."""
    reason: InputError | None = None
    for kernel_mm in _kernels(asked):
        try:
            sizes = _sized(asked, kernel_mm)
            ShellPlan.of(net, sizes, pole_mm)
        except InputError as error:
            reason = reason or error
            continue
        return sizes if asked.kernel_mm is not None else _readable(net, sizes, pole_mm)
    assert reason is not None
    raise reason


def _kernels(asked: AskedSizes) -> Iterator[float]:
    if asked.kernel_mm is not None:
        yield asked.kernel_mm
        return
    most = _MOST_KERNEL_MM if asked.outer_mm is None else asked.outer_mm / 2
    kernel_mm = _LEAST_KERNEL_MM
    yield kernel_mm
    while kernel_mm < most:
        kernel_mm = _FINEST_MM * math.ceil(_GROWTH * kernel_mm / _FINEST_MM)
        yield round(kernel_mm, 6)


def _sized(asked: AskedSizes, kernel_mm: float) -> ProbeSizes:
    enough = _STEP_MM * math.ceil(_SHELL_TO_KERNEL * kernel_mm / _STEP_MM - 1e-9)
    assert asked.wall_mm is not None
    return ProbeSizes(
        outer_mm=max(_LEAST_OUTER_MM, enough) if asked.outer_mm is None else asked.outer_mm,
        kernel_mm=kernel_mm,
        wall_mm=asked.wall_mm,
        clearance_mm=asked.clearance_mm,
        flare=FLARES[0] if asked.flare is None else asked.flare,
    )


def _readable(net: WallNet, sizes: ProbeSizes, pole_mm: float) -> ProbeSizes:
    """With faces that can be read, where the shell has room for the kernel."""
    larger = sizes
    while 2 * face_radii(net, larger).min() < _READABLE_MM:
        kernel_mm = round(larger.kernel_mm + _FINEST_MM, 6)
        if _SHELL_TO_KERNEL * kernel_mm > sizes.outer_mm:
            break
        larger = replace(larger, kernel_mm=kernel_mm)
    try:
        ShellPlan.of(net, larger, pole_mm)
    except InputError:
        return sizes
    return larger
