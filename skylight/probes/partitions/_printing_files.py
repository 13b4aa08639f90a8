"""The files of a printed partition probe: parts for the printer, assembly, report, figure."""

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from manifold3d import Manifold
from torch import Tensor

from skylight.probes._printing import (
    board_frame,
    describe_measured,
    describe_mount,
    summary_lines,
    write_print,
    write_print_figure,
)
from skylight.probes.fabrication._files import shaded_picture
from skylight.probes.fabrication._mount import BOARD_FROM_PROBE
from skylight.probes.fabrication._parts import part_of
from skylight.probes.fabrication._report import BASE, INK, PANEL_PX, PAPER, POLE, paper_parts
from skylight.probes.partitions._picture import draw_cells
from skylight.probes.partitions.printed._printing import PrintedPartitions
from skylight.sphere._rotation import RigidTransform

# linear reflectances; the shells are lighter than their paint, to be seen
_LOWER, _UPPER, _WHITE = (0.12, 0.13, 0.15), (0.22, 0.24, 0.28), (0.85, 0.85, 0.84)
_AZIMUTH, _ELEVATION = math.radians(-28.0), math.radians(24.0)


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
    printed, seen, rims = result.printed, result.visibility, result.rims_mm.sum(1)
    black = printed.lower.volume_mm3 + printed.upper.volume_mm3
    return [
        ("cells", f"{result.cells.count}"),
        ("half shells, black", f"{black / 1000:.1f} cm³"),
        ("kernel, white", f"{printed.kernel.volume_mm3 / 1000:.1f} cm³"),
        ("discs that are free on the faces", free_discs(result.face_radii_mm)),
        ("own light lost, mean and most", _shares(seen.loss)),
        ("others' light let in, mean and most", _shares(seen.leak)),
        ("rims of the walls", f"{rims.min():.1f} to {rims.max():.1f} mm"),
        ("pins", f"{len(printed.split.pinned)}"),
    ]


def free_discs(radii_mm: Float[np.ndarray, " n"]) -> str:
    """Diameters from the smallest to the largest, in words."""
    least, most = (f"{2 * radius:.1f}" for radius in (radii_mm.min(), radii_mm.max()))
    return f"{least} mm" if least == most else f"{least} to {most} mm"


def _shares(values: Float[Tensor, " n"]) -> str:
    return f"{100 * float(values.mean()):.1f} %, {100 * float(values.max()):.1f} %"


def write_printed_partitions(
    folder: Path, result: PrintedPartitions, *, panel_px: int = PANEL_PX
) -> None:
    """STL and 3MF files, assembly.png (panels of so many pixels), assembly.json, report.json."""
    write_print(
        folder,
        result,
        assembly=describe_partition_assembly(result),
        report=describe_partition_print(result),
    )
    sizes = result.sizes
    write_print_figure(
        folder / "assembly.png",
        result,
        title=result.cells.design.name,
        sizes=f"shell {sizes.outer_mm:g} mm, kernel {sizes.kernel_mm:g} mm from its centre, walls "
        f"{sizes.wall_mm:g} mm, clearance {sizes.clearance_mm:g} mm",
        panels={
            "On its pole and marker base": assembled(result, panel_px),
            "Taken apart along the pins": taken_apart(result, panel_px),
            "Its cells, from two sides": draw_cells(result.cells, size=panel_px // 2),
        },
        rows=_rows(result),
        panel_px=panel_px,
    )


def describe_partition_assembly(result: PrintedPartitions) -> dict[str, object]:
    """What assembly.json holds: how the probe stands, what it sees, and how it goes together."""
    rotation = result.printed.rotation
    return {
        **result.assembly.to_json(),
        "probe_frame": "the design's axes about the probe's centre, mm",
        "board_frame": board_frame("p"),
        "turn": "the notch in the base's front edge points to the bottom of the printed picture; "
        "turn the probe about its pole as in assembly.png"
        + (", its -Z to the top of the picture" if result.cells.design.oriented else ""),
        "way_in": (rotation.T @ result.printed.split.way_in).tolist(),
        "face_radii_mm": result.face_radii_mm.tolist(),
        "steps": [
            "paint both half shells a dull black, all but the pins; leave the kernel white",
            "lay the kernel into the lower half",
            "push the upper half onto its pins, along way_in, and glue them",
            "put the pole into the lower half's socket and the marker base",
        ],
        **describe_mount(result),
    }


def describe_partition_print(result: PrintedPartitions) -> dict[str, object]:
    """What report.json holds."""
    visibility = result.visibility
    return {
        "design": result.cells.design.name,
        "cells": result.cells.count,
        "parts_mm3": {part.name: part.volume_mm3 for part in result.printed.parts},
        "rims_mm": result.rims_mm.sum(1).tolist(),
        "pins": len(result.printed.split.pinned),
        "facing": visibility.facing.tolist(),
        "loss": visibility.loss.tolist(),
        "leak": visibility.leak.tolist(),
        "seen": "by the faces' centres; walls are taken to reflect nothing",
        **describe_measured(result),
    }


def summarise_partition_print(result: PrintedPartitions) -> str:
    """A few lines for the terminal."""
    printed, sizes = result.printed, result.sizes
    loss, leak = result.visibility.loss, result.visibility.leak
    shell = printed.lower.volume_mm3 + printed.upper.volume_mm3
    return "\n".join(
        [
            f"sizes       shell {sizes.outer_mm:g} mm, kernel {sizes.kernel_mm:g} mm from its "
            f"centre, walls {sizes.wall_mm:g} mm, at the rims up to "
            f"{result.rims_mm.sum(1).max():.1f} mm",
            *summary_lines(
                result,
                f"two half shells with {len(printed.split.pinned)} pins and a kernel",
                f"{shell / 1000:.1f} cm3 black, {printed.kernel.volume_mm3 / 1000:.1f} cm3 white",
            ),
            f"faces       discs of {free_discs(result.face_radii_mm)} across are free on them",
            f"sight       {100 * loss.mean():.1f} % of a cell's light is lost (at most "
            f"{100 * loss.max():.1f} %), {100 * leak.mean():.0f} % comes in from others (at most "
            f"{100 * leak.max():.0f} %)",
        ]
    )
