"""The files of a printed voxel probe: parts for the printer, assembly, report, figure."""

import math
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from manifold3d import Manifold

from skylight.probes._printing import (
    board_frame,
    describe_measured,
    describe_mount,
    summary_lines,
    write_print,
    write_print_figure,
)
from skylight.probes.fabrication._files import shaded_picture
from skylight.probes.fabrication._parts import PrintedPart, box, part_of
from skylight.probes.fabrication._report import (
    BASE,
    INK,
    PANEL_PX,
    PAPER,
    POLE,
    paper_parts,
)
from skylight.probes.voxel._model import ORIENTATIONS
from skylight.probes.voxel._printing import PrintedProbe, hidden_by_pole, voxel_assembly

# linear reflectances
_VOXELS = np.array(
    [
        [0.80, 0.42, 0.20],
        [0.28, 0.52, 0.66],
        [0.83, 0.66, 0.30],
        [0.35, 0.58, 0.42],
        [0.72, 0.7, 0.66],
    ]
)
_FOOT = (0.33, 0.36, 0.40)
_APART = 1.0  # of a face, between parts taken apart


def write_print_picture(path: Path, result: PrintedProbe, *, panel_px: int = PANEL_PX) -> None:
    """Write the picture as a PNG; panels are ``panel_px`` high."""
    sizes = result.printed.sizes
    write_print_figure(
        path,
        result,
        title=result.title,
        sizes=f"faces {sizes.face_mm:g} mm, walls {sizes.wall_mm:g} mm, "
        f"clearance {sizes.clearance_mm:g} mm",
        panels={
            "On its pole and marker base": assembled(result, panel_px),
            "Taken apart": taken_apart(result, panel_px),
            "On the printer's bed": on_bed(result, panel_px),
        },
        rows=_rows(result),
        panel_px=panel_px,
    )


def assembled(result: PrintedProbe, panel_px: int) -> UInt8[np.ndarray, "h w 3"]:
    """The probe assembled on its pole and marker base."""
    mount = result.mount
    parts = [mount.on_base(part) for part in (*result.printed.parts, mount.foot)]
    paper = paper_parts(result.board, result.paper_hole_mm)
    colours = [*_voxel_colours(result), _FOOT, BASE, POLE, PAPER, *[INK] * (len(paper) - 1)]
    return shaded_picture(
        [*parts, result.base, _rod(result), *paper],
        np.array(colours),
        size=(panel_px, panel_px),
        up=(0, 0, -1),
        azimuth_rad=math.radians(-62.0),
        elevation_rad=math.radians(24.0),
    )


def taken_apart(result: PrintedProbe, panel_px: int) -> UInt8[np.ndarray, "h w 3"]:
    """Every part drawn away from where the foot plugs in."""
    printed = result.printed
    step = _APART * printed.sizes.face_mm
    cells = printed.assembly.cells
    parts = [
        part.shifted(step * (cell - cells[0]).astype(float))
        for part, cell in zip(printed.parts, cells, strict=True)
    ]
    foot = result.mount.foot.shifted(np.array([0.0, -0.8 * step, 0.0]))
    return shaded_picture(
        [*parts, foot],
        np.array([*_voxel_colours(result), _FOOT]),
        size=(panel_px, panel_px),
        up=(0, 1, 0),
        azimuth_rad=math.radians(28.0),
        elevation_rad=math.radians(22.0),
    )


def on_bed(result: PrintedProbe, panel_px: int) -> UInt8[np.ndarray, "h w 3"]:
    """Parts and foot as they are printed."""
    width, depth, _ = result.bed.size_mm
    bed = part_of("bed", box(np.array([-4.0, -4.0, -1.0]), np.array([width + 4, depth + 4, -0.01])))
    return shaded_picture(
        [*result.bed.parts, bed],
        np.array([*_voxel_colours(result), _FOOT, (0.86, 0.87, 0.88)]),
        size=(panel_px, panel_px),
        up=(0, 0, 1),
        azimuth_rad=math.radians(-65.0),
        elevation_rad=math.radians(48.0),
    )


def _voxel_colours(result: PrintedProbe) -> Float[np.ndarray, "n 3"]:
    return _VOXELS[np.arange(len(result.printed.parts)) % len(_VOXELS)]


def _rod(result: PrintedProbe) -> PrintedPart:
    """The pole, between its stops, in the board's frame."""
    board, pole, sizes = result.board, result.pole, result.printed.sizes
    radius = pole.diameter_mm / 2
    rod = Manifold.cylinder(pole.length_mm, radius, radius, 48)
    low = board.paper_mm + sizes.wall_mm - pole.length_mm
    return part_of("pole", rod.translate((board.width_mm / 2, board.height_mm / 2, low)))


def _rows(result: PrintedProbe) -> list[tuple[str, str]]:
    report, printed = result.report, result.printed
    return [
        ("parts, and a foot", f"{len(printed.parts)}"),
        ("material", f"{printed.volume_mm3 / 1000:.1f} cm³"),
        ("saved against the solid model", f"{100 * result.saved:.1f} %"),
        ("foot", f"{result.mount.foot.volume_mm3 / 1000:.1f} cm³"),
        ("faces off the model's plane", f"{report.face_deviation_mm:.1g} mm"),
        ("longest bridge to print", f"{max(p.bridge_mm for p in report.parts):.1f} mm"),
    ]


PARTS = re.compile(r"part_[0-9]{2,}\.stl")  # as many as the model has


def write_printed_probe(folder: Path, result: PrintedProbe, *, panel_px: int = PANEL_PX) -> None:
    """STL and 3MF files, assembly.png (panels of so many pixels), assembly.json, report.json."""
    write_print(folder, result, assembly=describe_assembly(result), report=describe_print(result))
    write_print_picture(folder / "assembly.png", result, panel_px=panel_px)


def describe_assembly(result: PrintedProbe) -> dict[str, object]:
    """What assembly.json holds: how the probe stands on the board, and how it goes together."""
    printed = result.printed
    sizes, steps = printed.sizes, printed.assembly
    cells = np.argwhere(printed.model.occupied)
    centre = sizes.face_mm * (cells.min(0) + cells.max(0) + 1) / 2
    pole_hidden = hidden_by_pole(result)
    assembly = voxel_assembly(result)
    return {
        **assembly.to_json(),
        "probe_frame": "voxel (x, y, z) begins at that corner; +Y is up",
        "board_frame": board_frame("(voxel_mm p)"),
        "probe_centre_mm": assembly.to_board(centre / sizes.face_mm).tolist(),
        "turn": "the notches in the front edges of foot and base point the same way: to the "
        "bottom of the printed picture, which is the probe's +Z",
        "hidden_face": pole_hidden,
        "steps": [
            {
                "part": part.name,
                "voxel": cell,
                "onto": "foot" if parent < 0 else printed.parts[parent].name,
                "moves": ORIENTATIONS[side],
            }
            for part, cell, parent, side in zip(
                printed.parts,
                steps.cells.tolist(),
                steps.parents.tolist(),
                steps.toward_parent.tolist(),
                strict=True,
            )
        ],
        **describe_mount(result),
    }


def describe_print(result: PrintedProbe) -> dict[str, object]:
    """What report.json holds."""
    printed = result.printed
    return {
        "title": result.title,
        "voxels": len(printed.model),
        "solid_mm3": printed.solid_mm3,
        "parts_mm3": printed.volume_mm3,
        "foot_mm3": result.mount.foot.volume_mm3,
        "material_saved": result.saved,
        "bed_mm3": result.bed.volume_mm3,
        **describe_measured(result),
    }


def summarise_print(result: PrintedProbe) -> str:
    """A few lines for the terminal."""
    printed, hidden = result.printed, hidden_by_pole(result)
    slot = f"lightmap slot {hidden['orientation']} / {hidden['configuration']}"
    lost = "which no other face has" if hidden["slot_lost"] else "which other faces have too"
    return "\n".join(
        [
            *summary_lines(
                result,
                f"{len(printed.parts)} and a foot",
                f"{printed.volume_mm3 / 1000:.1f} cm3, {100 * result.saved:.0f} % less than the "
                "solid model",
                f", faces off by {result.report.face_deviation_mm:.1g} mm",
            ),
            f"hidden      the pole takes {slot}, {lost}",
        ]
    )
