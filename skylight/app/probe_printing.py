"""A voxel probe for the printer: parts, foot, marker base, what was measured, and pictures."""

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from skylight import __version__
from skylight.app.probe_pictures import write_print_picture
from skylight.errors import InputError
from skylight.imaging.files import write_json
from skylight.inverse.photo import Progress
from skylight.probes.capture.pose import OPENCV_FROM_BOARD
from skylight.probes.printing.files import write_3mf, write_stl
from skylight.probes.printing.layout import BedLayout, lay_out
from skylight.probes.printing.mount import MarkerBoard, Mount, Pole, make_mount
from skylight.probes.printing.report import PrintReport
from skylight.probes.printing.sizes import PrintSizes
from skylight.probes.voxel.faces import OCCLUDERS, ORIENTATIONS, exposed_faces
from skylight.probes.voxel.model import VoxelModel, read_voxels, star_probe
from skylight.probes.voxel.parts import VoxelParts, voxel_parts
from skylight.probes.voxel.placement import Placement, StandingProbe, describe_standing_probe
from skylight.probes.voxel.press_fit import DOWN
from skylight.probes.voxel.print_checks import check_voxel_parts


@dataclass(frozen=True, kw_only=True)
class PrintedProbe:
    """All that was made of a model: parts and mount as assembled, on the bed, and as measured."""

    title: str
    printed: VoxelParts
    pole: Pole
    board: MarkerBoard
    mount: Mount
    bed: BedLayout
    report: PrintReport

    @property
    def saved(self) -> float:
        """The share of the solid model's material that the parts do not need."""
        return 1 - self.printed.volume_mm3 / self.printed.solid_mm3


def print_voxel_probe(
    model: VoxelModel,
    sizes: PrintSizes,
    *,
    title: str,
    pole: Pole | None = None,
    board: MarkerBoard | None = None,
    spacing_mm: float = 3.0,
    progress: Progress | None = None,
) -> PrintedProbe:
    """Parts of a voxel model, its foot and base, laid out and measured.

    Raises
    ------
    InputError
        The model cannot be put together, or the sizes do not fit one another.
    """
    tell = progress or (lambda _stage, _share: None)
    pole, board = pole or Pole(), board or MarkerBoard()
    tell("making the parts", 0.0)
    printed = voxel_parts(model, sizes)
    mount = make_mount(printed.mount_lattice, printed.mount_collar, sizes, pole, board)
    bed = lay_out([*printed.parts, mount.foot], spacing_mm=spacing_mm)
    tell("measuring the parts", 0.3)
    report = check_voxel_parts(printed, mount.foot, alone=[mount.base])
    return PrintedProbe(
        title=title, printed=printed, pole=pole, board=board, mount=mount, bed=bed, report=report
    )


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
    parts = result.bed.parts
    write_stl(folder / "parts.stl", parts)
    write_3mf(folder / "parts.3mf", parts)
    for part in parts:
        alone = lay_out([part]).parts
        write_stl(folder / f"{part.name}.stl", alone)
    base = lay_out([result.mount.base]).parts
    write_stl(folder / "marker_base.stl", base)
    write_3mf(folder / "marker_base.3mf", base)
    write_json(folder / "assembly.json", describe_assembly(result))
    write_json(folder / "report.json", describe_print(result))
    write_print_picture(folder / "assembly.png", result, panel_px=panel_px)


def standing_probe(result: PrintedProbe) -> StandingProbe:
    """The probe on its pole in the frame of the board, where captures look for it."""
    mount, pole = result.mount, result.pole
    turn = OPENCV_FROM_BOARD.T
    place = Placement(
        voxel_mm=result.printed.sizes.face_mm,
        rotation=turn @ mount.rotation,
        translation_mm=turn @ mount.translation_mm,
    )
    cell = result.printed.assembly.cells[0].astype(np.float64)
    x, top, z = place.to_board(cell + np.array([0.5, 0.0, 0.5]))
    return StandingProbe(
        model=result.printed.model,
        placement=place,
        pole_mm=(float(x), float(z), pole.diameter_mm / 2, float(top)),
        board_mm=(result.board.width_mm, result.board.height_mm),
    )


def describe_assembly(result: PrintedProbe) -> dict[str, object]:
    """What assembly.json holds: how the probe stands on the board, and how it goes together."""
    printed, mount = result.printed, result.mount
    sizes, assembly = printed.sizes, printed.assembly
    cells = np.argwhere(printed.model.occupied)
    centre = sizes.face_mm * (cells.min(0) + cells.max(0) + 1) / 2
    pole_hidden = hidden_by_pole(result)
    standing = standing_probe(result)
    return {
        **describe_standing_probe(standing),
        "probe_frame": "voxel (x, y, z) begins at that corner; +Y is up",
        "board_frame": "mm: origin at the top left corner of the printed pattern, x right along "
        "its upper edge, y out of the paper, z towards its lower edge; a point p of the probe "
        "stands at rotation (voxel_mm p) + translation_mm",
        "probe_centre_mm": standing.placement.to_board(centre / sizes.face_mm).tolist(),
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
                assembly.cells.tolist(),
                assembly.parents.tolist(),
                assembly.toward_parent.tolist(),
                strict=True,
            )
        ],
        "version": __version__,
    }


def hidden_by_pole(result: PrintedProbe) -> dict[str, object]:
    """The face that the foot covers, and whether its lightmap slot has no other face."""
    faces = exposed_faces(result.printed.model)
    orientation, configuration = faces.orientation.numpy(), faces.configuration.numpy()
    cell = result.printed.assembly.cells[0]
    at = int(np.flatnonzero((orientation == DOWN) & (faces.cells.numpy() == cell).all(1))[0])
    slot = int(configuration[at])
    alike = int(((orientation == DOWN) & (configuration == slot)).sum()) - 1
    return {
        "voxel": cell.tolist(),
        "face": at,
        "orientation": ORIENTATIONS[DOWN],
        "configuration": slot,
        "occluders": [name for i, name in enumerate(OCCLUDERS) if slot >> i & 1],
        "other_faces_of_this_slot": alike,
        "slot_lost": alike == 0,
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
