"""A partition probe for the printer: parts, their layout on the bed, measurements, visibility."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from skylight.errors import InputError
from skylight.fabrication.layout import BedLayout, lay_out
from skylight.fabrication.mount import (
    MarkerBoard,
    Pole,
    base_stop_mm,
    boss_mm,
    marker_base,
    paper_hole_mm,
)
from skylight.fabrication.part import PrintedPart
from skylight.probes.partitions.cells import Cells
from skylight.probes.partitions.printed.assembly import PartitionAssembly, placed_parts
from skylight.probes.partitions.printed.fitting import (
    BED_MM,
    FLARES,
    AskedSizes,
    fitted_sizes,
)
from skylight.probes.partitions.printed.halves import ProbeParts, probe_parts, standing_rotation
from skylight.probes.partitions.printed.print_checks import (
    PartitionPrintReport,
    check_partition_parts,
)
from skylight.probes.partitions.printed.sizes import ProbeSizes
from skylight.probes.partitions.printed.visibility import Visibility, measure_visibility
from skylight.probes.partitions.printed.walls import rim_halves
from skylight.probes.partitions.seeds import ProbeDesign
from skylight.sphere.rigid_transform import RigidTransform
from skylight.work.progress import StageProgress

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
    assembly: PartitionAssembly
    face_radii_mm: Float[np.ndarray, " n"]

    @property
    def paper_hole_mm(self) -> float:
        """Diameter of the hole in the marker's paper."""
        return paper_hole_mm(
            self.pole, wall_mm=self.sizes.wall_mm, clearance_mm=self.sizes.clearance_mm
        )

    @property
    def rims_mm(self) -> Float[np.ndarray, "e 2"]:
        """See :func:`~skylight.probes.partitions.printed.walls.rim_halves`."""
        return rim_halves(self.printed.net, self.sizes)

    def too_large(self, bed_mm: float) -> list[str]:
        """Sentences about what does not fit on a square bed of that side, and what to do."""
        found = []
        mends = dict.fromkeys((part.name for part in self.bed.parts), "choose thinner walls")
        mends[self.base.name] = "choose a smaller board"
        for part in (*self.bed.parts, *lay_out([self.base]).parts):
            width, depth, _ = np.ptp(part.bounds, axis=0)
            if max(width, depth) > bed_mm:
                found.append(
                    f"{part.name} is {width:.0f} x {depth:.0f} mm, larger than a bed of "
                    f"{bed_mm:g} mm: {mends[part.name]}, or cut it in the slicer and glue the "
                    "pieces"
                )
        width, depth, _ = self.bed.size_mm
        if not found and max(width, depth) > bed_mm:
            found.append(
                f"parts.stl and parts.3mf are {width:.0f} x {depth:.0f} mm, larger than a bed of "
                f"{bed_mm:g} mm: print its parts one by one, from the files of their names"
            )
        return found

    @property
    def warnings(self) -> list[str]:
        """Sentences about what can be printed but will be hard to use."""
        good = _good_pole_mm(self.sizes, self.board)
        if self.pole.length_mm >= good:
            return []
        return [
            f"on a pole of {self.pole.length_mm:g} mm the shell hides part of the board from "
            f"cameras that look into it from above: make it {good:.0f} mm or longer"
        ]


def print_fitted(
    design: ProbeDesign,
    asked: AskedSizes,
    *,
    pole: Pole | None = None,
    board: MarkerBoard | None = None,
    bed_mm: float = BED_MM,
    progress: StageProgress | None = None,
) -> PrintedPartitions:
    """A design with the sizes that were asked for, and the others chosen so that it can be printed.

    See :func:`~skylight.probes.partitions.printed.fitting.fitted_sizes`. Where no flare was named,
    rims are as wide as leaves nothing thinner than the walls.

    Raises
    ------
    InputError
        What was asked for does not fit the design; the message names sizes that do.
    """
    pole = pole or Pole()
    sizes = fitted_sizes(Cells.of(design), asked, pole_mm=pole.diameter_mm, bed_mm=bed_mm)
    for flare in FLARES if asked.flare is None else (asked.flare,):
        result = print_partition_probe(
            design, replace(sizes, flare=flare), pole=pole, board=board, progress=progress
        )
        if result.report.sound:
            break
    return result


def print_partition_probe(
    design: ProbeDesign,
    sizes: ProbeSizes,
    *,
    pole: Pole | None = None,
    board: MarkerBoard | None = None,
    spacing_mm: float = 3.0,
    progress: StageProgress | None = None,
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
        assembly=PartitionAssembly(
            cells=cells,
            sizes=sizes,
            board_from_probe=RigidTransform.from_numpy(rotation, translation),
            pole_mm=pole_mm,
            board_mm=(board.width_mm, board.height_mm),
            response=visibility.response,
        ),
        face_radii_mm=placed.face_radii,
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
