"""The files of a printed voxel probe: parts for the printer, assembly, report, pictures."""

from dataclasses import asdict
from pathlib import Path

import numpy as np

from skylight import __version__
from skylight.app.probes.voxel.pictures import write_print_picture
from skylight.errors import InputError
from skylight.fabrication.files import write_printed_parts
from skylight.io.json_files import write_json
from skylight.probes.voxel.faces import ORIENTATIONS
from skylight.probes.voxel.model import VoxelModel, read_voxels, star_probe
from skylight.probes.voxel.printed.printing import PrintedProbe, hidden_by_pole, voxel_assembly


def probe_model(probe: int | None, voxels: Path | None, resolution: int) -> tuple[VoxelModel, str]:
    """(model, title) that the command line's options describe: a star, or a file."""
    if (probe is None) == (voxels is None):
        raise InputError("give either --probe, such as 3, or --voxels with a file")
    if probe is not None:
        return star_probe(probe), f"{probe}-probe"
    assert voxels is not None
    return read_voxels(voxels, resolution=resolution).cropped(), voxels.name


def write_printed_probe(folder: Path, result: PrintedProbe, *, panel_px: int = 600) -> None:
    """STL and 3MF files, assembly.png (panels of so many pixels), assembly.json, report.json."""
    write_printed_parts(folder, result.bed, result.mount.base)
    write_json(folder / "assembly.json", describe_assembly(result))
    write_json(folder / "report.json", describe_print(result))
    write_print_picture(folder / "assembly.png", result, panel_px=panel_px)


def describe_assembly(result: PrintedProbe) -> dict[str, object]:
    """What assembly.json holds: how the probe stands on the board, and how it goes together."""
    printed, mount = result.printed, result.mount
    sizes, steps = printed.sizes, printed.assembly
    cells = np.argwhere(printed.model.occupied)
    centre = sizes.face_mm * (cells.min(0) + cells.max(0) + 1) / 2
    pole_hidden = hidden_by_pole(result)
    assembly = voxel_assembly(result)
    return {
        **assembly.to_json(),
        "probe_frame": "voxel (x, y, z) begins at that corner; +Y is up",
        "board_frame": "mm: origin at the top left corner of the printed pattern, x right along "
        "its upper edge, y out of the paper, z towards its lower edge; a point p of the probe "
        "stands at rotation (voxel_mm p) + translation_mm",
        "probe_centre_mm": assembly.to_board(centre / sizes.face_mm).tolist(),
        "turn": "the notches in the front edges of foot and base point the same way: to the "
        "bottom of the printed picture, which is the probe's +Z",
        "board": {
            **asdict(result.board),
            "paper_width_mm": result.board.width_mm + 2 * result.board.margin_mm,
            "paper_height_mm": result.board.height_mm + 2 * result.board.margin_mm,
            "paper_hole_mm": mount.paper_hole_mm,
        },
        "pole": asdict(result.pole),
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
        "version": __version__,
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
        "marker_base_mm3": result.mount.base.volume_mm3,
        "material_saved": result.saved,
        "bed_mm": list(result.bed.size_mm),
        "bed_mm3": result.bed.volume_mm3,
        **result.report.content(),
        "version": __version__,
    }


def summarise_print(result: PrintedProbe) -> str:
    """A few lines for the terminal."""
    report, printed = result.report, result.printed
    least, largest = report.clearances_mm
    hidden = hidden_by_pole(result)
    slot = f"lightmap slot {hidden['orientation']} / {hidden['configuration']}"
    width, depth, height = result.bed.size_mm
    lost = "which no other face has" if hidden["slot_lost"] else "which other faces have too"
    return "\n".join(
        [
            f"parts       {len(printed.parts)} and a foot, on {width:.0f} x {depth:.0f} mm, "
            f"{height:.0f} mm high",
            f"material    {printed.volume_mm3 / 1000:.1f} cm3, {100 * result.saved:.0f} % less "
            "than the solid model",
            f"measured    walls {report.thinnest_mm:.2f} mm or more, clearances {least:.2f} to "
            f"{largest:.2f} mm, faces off by {report.face_deviation_mm:.1g} mm",
            f"hidden      the pole takes {slot}, {lost}",
        ]
    )
