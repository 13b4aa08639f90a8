"""The files of a printed partition probe: parts for the printer, assembly, report, pictures."""

from dataclasses import asdict
from pathlib import Path

from skylight import __version__
from skylight.app.probes.partitions.pictures import free_discs, write_partition_picture
from skylight.fabrication.files import write_printed_parts
from skylight.io.json_files import write_json
from skylight.probes.partitions.printed.printing import PrintedPartitions


def write_printed_partitions(
    folder: Path, result: PrintedPartitions, *, panel_px: int = 600
) -> None:
    """STL and 3MF files, assembly.png (panels of so many pixels), assembly.json, report.json."""
    write_printed_parts(folder, result.bed, result.base)
    write_json(folder / "assembly.json", describe_partition_assembly(result))
    write_json(folder / "report.json", describe_partition_print(result))
    write_partition_picture(folder / "assembly.png", result, panel_px=panel_px)


def describe_partition_assembly(result: PrintedPartitions) -> dict[str, object]:
    """What assembly.json holds: how the probe stands, what it sees, and how it goes together."""
    board, rotation = result.board, result.printed.rotation
    return {
        **result.assembly.to_json(),
        "probe_frame": "the design's axes about the probe's centre, mm",
        "board_frame": "mm: origin at the top left corner of the printed pattern, x right along "
        "its upper edge, y out of the paper, z towards its lower edge; a point p of the probe "
        "stands at rotation p + translation_mm",
        "turn": "the notch in the base's front edge points to the bottom of the printed picture; "
        "turn the probe about its pole as in assembly.png"
        + (", its -Z to the top of the picture" if result.cells.design.oriented else ""),
        "board": {
            **asdict(board),
            "paper_width_mm": board.width_mm + 2 * board.margin_mm,
            "paper_height_mm": board.height_mm + 2 * board.margin_mm,
            "paper_hole_mm": result.paper_hole_mm,
        },
        "pole": asdict(result.pole),
        "way_in": (rotation.T @ result.printed.split.way_in).tolist(),
        "face_radii_mm": result.face_radii_mm.tolist(),
        "steps": [
            "paint both half shells a dull black, all but the pins; leave the kernel white",
            "lay the kernel into the lower half",
            "push the upper half onto its pins, along way_in, and glue them",
            "put the pole into the lower half's socket and the marker base",
        ],
        "version": __version__,
    }


def describe_partition_print(result: PrintedPartitions) -> dict[str, object]:
    """What report.json holds."""
    visibility = result.visibility
    return {
        "design": result.cells.design.name,
        "cells": result.cells.count,
        "parts_mm3": {part.name: part.volume_mm3 for part in result.printed.parts},
        "marker_base_mm3": result.base.volume_mm3,
        "bed_mm": list(result.bed.size_mm),
        "rims_mm": result.rims_mm.sum(1).tolist(),
        "pins": len(result.printed.split.pinned),
        "facing": visibility.facing.tolist(),
        "loss": visibility.loss.tolist(),
        "leak": visibility.leak.tolist(),
        "seen": "by the faces' centres; walls are taken to reflect nothing",
        **result.report.content(),
        "version": __version__,
    }


def summarise_partition_print(result: PrintedPartitions) -> str:
    """A few lines for the terminal."""
    report, visibility = result.report, result.visibility
    least, largest = report.clearances_mm
    width, depth, height = result.bed.size_mm
    loss, leak, sizes = visibility.loss, visibility.leak, result.sizes
    shell = sum(part.volume_mm3 for part in (result.printed.lower, result.printed.upper))
    return "\n".join(
        [
            f"sizes       shell {sizes.outer_mm:g} mm, kernel {sizes.kernel_mm:g} mm from its "
            f"centre, walls {sizes.wall_mm:g} mm, at the rims up to "
            f"{result.rims_mm.sum(1).max():.1f} mm",
            f"parts       two half shells with {len(result.printed.split.pinned)} pins and a "
            f"kernel, on {width:.0f} x {depth:.0f} mm, {height:.0f} mm high",
            f"material    {shell / 1000:.1f} cm3 black, "
            f"{result.printed.kernel.volume_mm3 / 1000:.1f} cm3 white",
            f"measured    walls {report.thinnest_mm:.2f} mm or more, clearances {least:.2f} to "
            f"{largest:.2f} mm",
            f"faces       discs of {free_discs(result.face_radii_mm)} across are free on them",
            f"sight       {100 * loss.mean():.1f} % of a cell's light is lost (at most "
            f"{100 * loss.max():.1f} %), {100 * leak.mean():.0f} % comes in from others (at most "
            f"{100 * leak.max():.0f} %)",
        ]
    )
