"""The figure of a printed partition probe: assembled, exploded, its cells, and numbers."""

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from manifold3d import Manifold
from torch import Tensor

from skylight.app.probes.print_sheet import (
    BASE,
    INK,
    PANEL_PX,
    PAPER,
    POLE,
    paper_parts,
    write_sheet_of_prints,
)
from skylight.fabrication.mount import BOARD_FROM_PROBE
from skylight.fabrication.part import part_of
from skylight.fabrication.picture import shaded_picture
from skylight.probes.partitions.picture import draw_cells
from skylight.probes.partitions.printed.printing import PrintedPartitions
from skylight.sphere.rigid_transform import RigidTransform

# linear reflectances; the shells are lighter than their paint, to be seen
_LOWER, _UPPER, _WHITE = (0.12, 0.13, 0.15), (0.22, 0.24, 0.28), (0.85, 0.85, 0.84)
_AZIMUTH, _ELEVATION = math.radians(-28.0), math.radians(24.0)


def write_partition_picture(
    path: Path, result: PrintedPartitions, *, panel_px: int = PANEL_PX
) -> None:
    """Write the picture as a PNG; panels are ``panel_px`` high."""
    sizes = result.sizes
    write_sheet_of_prints(
        path,
        title=result.cells.design.name,
        sizes=f"shell {sizes.outer_mm:g} mm, kernel {sizes.kernel_mm:g} mm from its centre, walls "
        f"{sizes.wall_mm:g} mm, clearance {sizes.clearance_mm:g} mm",
        problems=result.report.problems,
        panels={
            "On its pole and marker base": assembled(result, panel_px),
            "Taken apart along the pins": taken_apart(result, panel_px),
            "Its cells, from two sides": draw_cells(result.cells, size=panel_px // 2),
        },
        rows=_rows(result),
        panel_px=panel_px,
    )


def assembled(result: PrintedPartitions, panel_px: int) -> UInt8[np.ndarray, "h w 3"]:
    """The probe assembled on its pole and marker base."""
    x, z, radius, top = result.assembly.pole_mm
    rod = Manifold.cylinder(result.pole.length_mm, radius, radius, 48).rotate((-90, 0, 0))
    rod = rod.translate((x, top - result.pole.length_mm, z))
    flat = [result.base, *paper_parts(result.board, result.paper_hole_mm)]
    upright = RigidTransform.from_numpy(BOARD_FROM_PROBE.T, np.zeros(3))
    lying = [part.moved(upright) for part in flat]
    centre = result.assembly.board_from_probe.translation.numpy()
    placed = [part.shifted(centre) for part in result.printed.parts]
    return shaded_picture(
        [*placed, part_of("pole", rod, (0, 1, 0)), *lying],
        np.array([_LOWER, _WHITE, _UPPER, POLE, BASE, PAPER, *[INK] * (len(lying) - 2)]),
        size=(panel_px, panel_px),
        up=(0, 1, 0),
        azimuth_rad=_AZIMUTH,
        elevation_rad=_ELEVATION,
    )


def taken_apart(result: PrintedPartitions, panel_px: int) -> UInt8[np.ndarray, "h w 3"]:
    """The halves drawn away from the kernel, seen across the way in."""
    printed = result.printed
    way = printed.split.way_in
    step = 0.75 * result.sizes.outer_mm * way
    across = math.atan2(float(way[0]), float(way[2])) + math.pi / 2
    return shaded_picture(
        [printed.lower.shifted(-step), printed.kernel, printed.upper.shifted(step)],
        np.array([_LOWER, _WHITE, _UPPER]) + 0.1,
        size=(panel_px, panel_px),
        up=(0, 1, 0),
        azimuth_rad=across,
        elevation_rad=math.radians(12.0),
    )


def _rows(result: PrintedPartitions) -> list[tuple[str, str]]:
    report, printed, seen = result.report, result.printed, result.visibility
    least, largest = report.clearances_mm
    width, depth, height = result.bed.size_mm
    rims = result.rims_mm.sum(1)
    black = printed.lower.volume_mm3 + printed.upper.volume_mm3
    return [
        ("cells", f"{result.cells.count}"),
        ("half shells, black", f"{black / 1000:.1f} cm³"),
        ("kernel, white", f"{printed.kernel.volume_mm3 / 1000:.1f} cm³"),
        ("marker base", f"{result.base.volume_mm3 / 1000:.1f} cm³"),
        ("on the bed", f"{width:.0f} × {depth:.0f} × {height:.0f} mm"),
        ("thinnest wall, measured", f"{report.thinnest_mm:.3f} mm"),
        ("clearances, measured", f"{least:.3f} to {largest:.3f} mm"),
        ("parts share, when assembled", f"{report.overlap_mm3:.1g} mm³"),
        ("discs that are free on the faces", free_discs(result.face_radii_mm)),
        ("own light lost, mean and most", _shares(seen.loss)),
        ("others' light let in, mean and most", _shares(seen.leak)),
        ("rims of the walls", f"{rims.min():.1f} to {rims.max():.1f} mm"),
        ("pins", f"{len(printed.split.pinned)}"),
        ("pole", f"{result.pole.diameter_mm:g} × {result.pole.length_mm:g} mm"),
        ("hole in the marker's paper", f"{result.paper_hole_mm:.1f} mm"),
        ("all checks", "pass" if report.sound else f"{len(report.problems)} fail"),
    ]


def free_discs(radii_mm: Float[np.ndarray, " n"]) -> str:
    """Diameters from the smallest to the largest, in words."""
    least, most = (f"{2 * radius:.1f}" for radius in (radii_mm.min(), radii_mm.max()))
    return f"{least} mm" if least == most else f"{least} to {most} mm"


def _shares(values: Float[Tensor, " n"]) -> str:
    return f"{100 * float(values.mean()):.1f} %, {100 * float(values.max()):.1f} %"
