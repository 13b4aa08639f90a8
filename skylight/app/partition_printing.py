"""A partition probe for the printer: shells, kernel, marker base, what was measured, pictures."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from skylight import __version__
from skylight.app.partition_pictures import free_discs, write_partition_picture
from skylight.errors import InputError
from skylight.imaging.files import write_json
from skylight.inverse.photo import Progress
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.design import ProbeDesign
from skylight.probes.partitions.halves import ProbeParts, probe_parts, standing_rotation
from skylight.probes.partitions.placement import (
    StandingPartitions,
    describe_standing_partitions,
    placed_parts,
)
from skylight.probes.partitions.print_checks import PartitionPrintReport, check_partition_parts
from skylight.probes.partitions.sizes import ProbeSizes
from skylight.probes.partitions.visibility import Visibility, measure_visibility
from skylight.probes.printing.files import write_3mf, write_stl
from skylight.probes.printing.layout import BedLayout, lay_out
from skylight.probes.printing.mount import (
    MarkerBoard,
    Pole,
    base_stop_mm,
    boss_mm,
    marker_base,
    paper_hole_mm,
)
from skylight.probes.printing.part import PrintedPart

_HANGING = 2.0  # diameters of the shell, between it and the board


@dataclass(frozen=True, kw_only=True)
class PrintedPartitions:
    """All that was made of a design: parts as assembled and on the bed, and as measured."""

    cells: Cells
    sizes: ProbeSizes
    printed: ProbeParts
    pole: Pole
    board: MarkerBoard
    base: PrintedPart
    bed: BedLayout
    report: PartitionPrintReport
    visibility: Visibility
    standing: StandingPartitions
    face_radii_mm: Float[np.ndarray, " n"]

    @property
    def paper_hole_mm(self) -> float:
        """Diameter of the hole in the marker's paper."""
        return paper_hole_mm(
            self.pole, wall_mm=self.sizes.wall_mm, clearance_mm=self.sizes.clearance_mm
        )

    @property
    def doubts(self) -> list[str]:
        """Sentences about what can be printed but will be hard to use."""
        good = _good_pole_mm(self.sizes, self.board)
        if self.pole.length_mm >= good:
            return []
        return [
            f"on a pole of {self.pole.length_mm:g} mm the shell hides part of the board from "
            f"cameras that look into it from above: make it {good:.0f} mm or longer"
        ]


def print_partition_probe(
    design: ProbeDesign,
    sizes: ProbeSizes,
    *,
    pole: Pole | None = None,
    board: MarkerBoard | None = None,
    spacing_mm: float = 3.0,
    progress: Progress | None = None,
) -> PrintedPartitions:
    """Half shells, kernel and marker base of a design, laid out, measured, and what they see.

    Raises
    ------
    InputError
        The sizes do not fit the design or one another.
    """
    tell = progress or (lambda _stage, _share: None)
    pole, board = pole or Pole(), board or MarkerBoard()
    tell("making the parts", 0.0)
    cells = Cells.of(design)
    rotation = standing_rotation(cells)
    printed = probe_parts(cells, sizes, rotation=rotation, pole_mm=pole.diameter_mm)
    translation = _over_board(printed, sizes, pole, board)
    x, z = printed.foot.axis
    pole_mm = (
        float(x + translation[0]),
        float(z + translation[2]),
        pole.diameter_mm / 2,
        float(printed.foot.top_mm + translation[1]),
    )
    base = marker_base(pole, board, wall_mm=sizes.wall_mm, clearance_mm=sizes.clearance_mm)
    tell("measuring the parts", 0.2)
    report = check_partition_parts(printed, sizes, alone=[base])
    tell("looking out of the cells", 0.7)
    placed = placed_parts(printed, sizes, translation, pole_mm)
    visibility = measure_visibility(
        cells,
        placed.caster,
        centres=placed.face_centres,
        radii=placed.face_radii,
        rotation=rotation,
    )
    return PrintedPartitions(
        cells=cells,
        sizes=sizes,
        printed=printed,
        pole=pole,
        board=board,
        base=base,
        bed=lay_out([*_lying(printed)], spacing_mm=spacing_mm),
        report=report,
        visibility=visibility,
        standing=StandingPartitions(
            design=design,
            sizes=sizes,
            rotation=rotation,
            translation_mm=translation,
            pole_mm=pole_mm,
            board_mm=(board.width_mm, board.height_mm),
            response=visibility.response,
        ),
        face_radii_mm=placed.face_radii,
    )


def write_printed_partitions(
    folder: Path, result: PrintedPartitions, *, panel_px: int = 600
) -> None:
    """STL and 3MF files, assembly.png (panels of so many pixels), assembly.json, report.json."""
    parts = result.bed.parts
    write_stl(folder / "parts.stl", parts)
    write_3mf(folder / "parts.3mf", parts)
    for part in parts:
        write_stl(folder / f"{part.name}.stl", lay_out([part]).parts)
    base = lay_out([result.base]).parts
    write_stl(folder / "marker_base.stl", base)
    write_3mf(folder / "marker_base.3mf", base)
    write_json(folder / "assembly.json", describe_partition_assembly(result))
    write_json(folder / "report.json", describe_partition_print(result))
    write_partition_picture(folder / "assembly.png", result, panel_px=panel_px)


def describe_partition_assembly(result: PrintedPartitions) -> dict[str, object]:
    """What assembly.json holds: how the probe stands, what it sees, and how it goes together."""
    board, rotation = result.board, result.printed.rotation
    return {
        **describe_standing_partitions(result.standing),
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
    loss, leak = visibility.loss, visibility.leak
    shell = sum(part.volume_mm3 for part in (result.printed.lower, result.printed.upper))
    return "\n".join(
        [
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


def _over_board(
    printed: ProbeParts, sizes: ProbeSizes, pole: Pole, board: MarkerBoard
) -> Float[np.ndarray, " 3"]:
    """From the standing probe's frame to the board's: the pole stands in its middle."""
    foot = printed.foot
    stop = base_stop_mm(board, sizes.wall_mm)
    height = pole.length_mm - stop - foot.top_mm
    clear = height + foot.bottom_mm - boss_mm(pole, board)
    if clear < 0:
        raise InputError(
            f"a pole of {pole.length_mm:g} mm is lost in its sockets: make it longer than "
            f"{pole.length_mm - clear:.0f} mm, better {_good_pole_mm(sizes, board):.0f} mm"
        )
    x, z = foot.axis
    return np.array([board.width_mm / 2 - x, height, board.height_mm / 2 - z])


def _good_pole_mm(sizes: ProbeSizes, board: MarkerBoard) -> float:
    """Length of a pole up to a shell that hangs twice its diameter over the board.

    From 60 degrees above the horizon, the shell then hides none of the default board.
    """
    return base_stop_mm(board, sizes.wall_mm) + _HANGING * sizes.outer_mm


def _lying(printed: ProbeParts) -> list[PrintedPart]:
    """Parts as they are printed: half shells on their cut, the kernel on its largest face."""
    way = printed.split.way_in
    widest = printed.net.normals[_largest_face(printed)]
    return [
        _turned(printed.lower, -way),
        _turned(printed.upper, way),
        _turned(printed.kernel, -widest),
    ]


def _largest_face(printed: ProbeParts) -> int:
    corners = printed.kernel.corners
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    along = cross @ printed.net.normals.T / np.maximum(area, 1e-12)[:, None]
    return int((area @ (along > 1 - 1e-6)).round(6).argmax())


def _turned(part: PrintedPart, up: Float[np.ndarray, " 3"]) -> PrintedPart:
    """With a direction of its frame along +Z."""
    across = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    across /= np.linalg.norm(across)
    turn = np.stack([across, np.cross(up, across), up])
    return replace(part, vertices=part.vertices @ turn.T, up=(0, 0, 1))
