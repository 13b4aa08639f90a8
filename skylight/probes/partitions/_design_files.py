"""Partition-probe designs optimised for a folder of maps or for simulated skies; files to files.

The files of a printed partition probe: parts for the printer, assembly, report, pictures.

The figure of a printed partition probe: assembled, exploded, its cells, and numbers.
"""

import math
from dataclasses import asdict
from datetime import date
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from manifold3d import Manifold
from torch import Tensor

from skylight import __version__
from skylight.errors import InputError
from skylight.io._bounded import write_json
from skylight.io._files import write_png
from skylight.probes.fabrication._files import shaded_picture, write_printed_parts
from skylight.probes.fabrication._mount import BOARD_FROM_PROBE
from skylight.probes.fabrication._parts import part_of
from skylight.probes.fabrication._report import (
    BASE,
    INK,
    PANEL_PX,
    PAPER,
    POLE,
    paper_parts,
    write_sheet_of_prints,
)
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._picture import draw_cells
from skylight.probes.partitions._seeds import ProbeDesign, save_design
from skylight.probes.partitions._sun_path import path_design, sun_path
from skylight.probes.partitions._tailored import Optimised
from skylight.probes.partitions.printed._printing import PrintedPartitions
from skylight.skies._sun import Place
from skylight.sphere._rotation import RigidTransform


def place_and_day(latitude_deg: float, longitude_deg: float, day: str) -> tuple[Place, date]:
    """As users write them: degrees north and east, and YYYY-MM-DD."""
    if not (-90 <= latitude_deg <= 90 and -180 <= longitude_deg <= 180):
        raise InputError(
            f"{latitude_deg:g}, {longitude_deg:g} is no place: latitudes are -90 to 90, longitudes "
            "-180 to 180 degrees"
        )
    try:
        return Place(latitude_deg=latitude_deg, longitude_deg=longitude_deg), date.fromisoformat(
            day
        )
    except ValueError as error:
        raise InputError(f"{day!r} is no day: write it as 2026-06-21") from error


def tailored_designs(count: int, sun: tuple[Place, date] | None = None) -> list[ProbeDesign]:
    """The thesis' designs of so many cells for such light: for rooms, or for a day's sun path."""
    if sun is None:
        return [named_design("14d-indoor")] if count == 14 else []
    path = sun_path(*sun)
    base = named_design("6d")
    # where the path runs through base cells they are cut, which makes more of them
    for cells in range(count - 1, 0, -1):
        design = path_design(f"6d-sun-{cells}", base, cells, path)
        if design.count == count:
            return [design]
    return []


def write_optimised(folder: Path, result: Optimised) -> None:
    """design.json, design.png and report.json."""
    save_design(folder / "design.json", result.design)
    write_png(folder / "design.png", draw_cells(Cells.of(result.design)))
    write_json(
        folder / "report.json",
        {
            "design": result.design.name,
            "mae": {name: asdict(score) for name, score in result.scores.items()},
            "gain": result.gain,
            "training": result.training,
            "held_out": result.held_out,
        },
    )


def summarise_optimised(result: Optimised) -> str:
    """A table of the scores, and the gain."""
    lines = ["relighting MAE          searched on   held out"]
    lines += [
        f"{name:<24}{score.training:>11.4f}{score.held_out:>11.4f}"
        for name, score in result.scores.items()
    ]
    first = next(iter(result.scores))
    less = "less" if result.gain >= 0 else "more"
    lines.append(
        f"{result.design.name} errs {abs(result.gain):.1%} {less} than {first} on "
        f"{len(result.held_out)} lights that the search did not see"
    )
    return "\n".join(lines)


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
