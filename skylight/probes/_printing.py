"""Printed probes on their pole and marker base: what the files of all kinds have in common."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from jaxtyping import UInt8
from numpy import ndarray

from skylight import __version__
from skylight.io._bounded import write_json
from skylight.probes.fabrication._files import write_printed_parts
from skylight.probes.fabrication._mount import MarkerBoard, Pole
from skylight.probes.fabrication._parts import BedLayout, PrintedPart
from skylight.probes.fabrication._report import MeasuredParts, write_sheet_of_prints


@dataclass(frozen=True, kw_only=True)
class MountedPrint(ABC):
    """All that was made of a probe: its parts on the bed, its mount, and what was measured."""

    pole: Pole
    board: MarkerBoard
    base: PrintedPart
    bed: BedLayout
    report: MeasuredParts

    @property
    @abstractmethod
    def paper_hole_mm(self) -> float:
        """Diameter of the hole in the marker's paper."""


def board_frame(point: str) -> str:
    """The frame of assembly.json in words; ``point`` is a point p of the probe in mm."""
    return (
        "mm: origin at the top left corner of the printed pattern, x right along its upper edge, "
        "y out of the paper, z towards its lower edge; a point p of the probe stands at rotation "
        f"{point} + translation_mm"
    )


def describe_mount(result: MountedPrint) -> dict[str, object]:
    """What assembly.json says of pole and board."""
    board = result.board
    return {
        "board": {
            **asdict(board),
            "paper_width_mm": board.width_mm + 2 * board.margin_mm,
            "paper_height_mm": board.height_mm + 2 * board.margin_mm,
            "paper_hole_mm": result.paper_hole_mm,
        },
        "pole": asdict(result.pole),
        "version": __version__,
    }


def describe_measured(result: MountedPrint) -> dict[str, object]:
    """What report.json says of base, bed and checks."""
    return {
        "marker_base_mm3": result.base.volume_mm3,
        "bed_mm": list(result.bed.size_mm),
        **result.report.content(),
        "version": __version__,
    }


def write_print(
    folder: Path,
    result: MountedPrint,
    *,
    assembly: Mapping[str, object],
    report: Mapping[str, object],
) -> None:
    """STL and 3MF files of parts and marker base, assembly.json and report.json.

    report.json has the STL files' figures as well, as they were read back from ``folder``.
    """
    files = write_printed_parts(folder, result.bed, result.base)
    write_json(folder / "assembly.json", assembly)
    write_json(folder / "report.json", {**report, "files": [asdict(file) for file in files]})


def write_print_figure(
    path: Path,
    result: MountedPrint,
    *,
    title: str,
    sizes: str,
    panels: Mapping[str, UInt8[ndarray, "_ _ 3"]],
    rows: Sequence[tuple[str, str]],
    panel_px: int,
) -> None:
    """Three pictures ``panel_px`` high, and a table of ``rows`` and what was measured."""
    report = result.report
    least, largest = report.clearances_mm
    width, depth, height = result.bed.size_mm
    measured = [
        ("marker base", f"{result.base.volume_mm3 / 1000:.1f} cm³"),
        ("on the bed", f"{width:.0f} × {depth:.0f} × {height:.0f} mm"),
        ("thinnest wall, measured", f"{report.thinnest_mm:.3f} mm"),
        ("clearances, measured", f"{least:.3f} to {largest:.3f} mm"),
        ("parts share, when assembled", f"{report.overlap_mm3:.1g} mm³"),
        ("pole", f"{result.pole.diameter_mm:g} × {result.pole.length_mm:g} mm"),
        ("hole in the marker's paper", f"{result.paper_hole_mm:.1f} mm"),
        ("all checks", "pass" if report.sound else f"{len(report.problems)} fail"),
    ]
    write_sheet_of_prints(
        path,
        title=title,
        sizes=sizes,
        problems=report.problems,
        panels=panels,
        rows=[*rows, *measured],
        panel_px=panel_px,
    )


def summary_lines(result: MountedPrint, parts: str, material: str, measured: str = "") -> list[str]:
    """For the terminal: the parts on the bed, their material, and what was measured on them."""
    width, depth, height = result.bed.size_mm
    least, largest = result.report.clearances_mm
    return [
        f"parts       {parts}, on {width:.0f} x {depth:.0f} mm, {height:.0f} mm high",
        f"material    {material}",
        f"measured    walls {result.report.thinnest_mm:.2f} mm or more, clearances "
        f"{least:.2f} to {largest:.2f} mm{measured}",
    ]
