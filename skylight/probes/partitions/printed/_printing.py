"""A partition probe for the printer: parts, their layout on the bed, and what is measured on them.

Parts are measured as they stand when assembled. What each face sees of each cell is found by ray
casting: walls are not infinitely thin, nor are faces at the centre: a face loses some of its own
cell's light to the walls, the pins and the pole, and, seen from ``kernel_mm`` above the centre, the
walls end before the cell does, so that light of neighbouring cells leaks in. Surfaces are taken to
be black but for the faces: what a black paint of some 4 % reflects is not in here.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from manifold3d import Manifold
from torch import Tensor

from skylight.errors import InputError
from skylight.probes._printing import MountedPrint
from skylight.probes.fabrication._checks import meets_on_its_way, overlap_mm3, part_figures, play_mm
from skylight.probes.fabrication._mount import (
    MarkerBoard,
    Pole,
    base_stop_mm,
    boss_mm,
    marker_base,
    paper_hole_mm,
)
from skylight.probes.fabrication._parts import PrintedPart, lay_out
from skylight.probes.fabrication._report import FACE_TOLERANCE_MM, MeasuredParts, clearance_problems
from skylight.probes.partitions._cells import Cells, tangents
from skylight.probes.partitions._seeds import ProbeDesign
from skylight.probes.partitions.printed._assembly import (
    BED_MM,
    FLARES,
    AskedSizes,
    PartitionAssembly,
    fitted_sizes,
    placed_parts,
)
from skylight.probes.partitions.printed._halves import (
    Foot,
    ProbeParts,
    probe_parts,
    standing_rotation,
)
from skylight.probes.partitions.printed._solids import ProbeSizes, WallNet, frame_along, rim_halves
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._rotation import RigidTransform
from skylight.transport._rays import Raycaster
from skylight.work._progress import StageProgress

# two sides within 37 degrees of parallel make a wall, others an edge
OPPOSED_COS = 0.8
_FAR = 4.0  # clearances up to which play is looked for


@dataclass(frozen=True, kw_only=True)
class PartitionPrintReport(MeasuredParts):
    """Figures of all parts; ``problems`` is empty where all is well.

    ``kernel_play_mm``: how far the kernel moves in the closed shell along +-x, +-y, +-z;
    ``pin_play_mm``: how far the upper half does on its pins, at right angles to them;
    ``seam_mm``: how far it goes on down. ``face_deviation_mm``: the faces' centres from where they
    should be.
    """

    sizes: ProbeSizes
    kernel_play_mm: tuple[float, ...]
    pin_play_mm: tuple[float, ...]
    seam_mm: float

    @property
    def clearances_mm(self) -> tuple[float, float]:
        """(least, largest) of all that meets."""
        every = (*self.kernel_play_mm, *self.pin_play_mm, self.seam_mm)
        return min(every), max(every)

    @property
    def problems(self) -> tuple[str, ...]:
        """One line for each verdict that fails."""
        found = self._part_problems(self.sizes.wall_mm)
        plays = {
            "kernel in its shell": self.kernel_play_mm,
            "upper half on its pins": self.pin_play_mm,
            "upper half on the lower": (self.seam_mm,),
        }
        for name, play in plays.items():
            found += clearance_problems(name, play, self.sizes.clearance_mm)
        found += self._fit_problems()
        if not self.face_deviation_mm <= FACE_TOLERANCE_MM:
            found.append(f"faces are up to {self.face_deviation_mm:.3g} mm off their planes")
        return tuple(found)


def check_partition_parts(
    printed: ProbeParts, sizes: ProbeSizes, *, alone: Sequence[PrintedPart] = ()
) -> PartitionPrintReport:
    """Measure shells and kernel as they stand, and others ``alone``."""
    solids = [part.solid() for part in printed.parts]
    lower, kernel, upper = solids
    farthest = _FAR * sizes.clearance_mm
    way = printed.split.way_in
    axes = [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    shell = None if lower is None or upper is None else lower + upper
    # from the mesh: the kernel's reach along the normal of each face
    reach = (printed.kernel.vertices @ printed.net.normals.T).max(0)
    return PartitionPrintReport(
        sizes=sizes,
        parts=tuple(
            part_figures(part, opposed_cos=OPPOSED_COS) for part in (*printed.parts, *alone)
        ),
        kernel_play_mm=tuple(play_mm(shell, kernel, axis, farthest) for axis in axes),
        pin_play_mm=tuple(
            play_mm(lower, upper, sign * side, farthest)
            for side in frame_along(way)[:2]
            for sign in (1, -1)
        ),
        seam_mm=play_mm(lower, upper, -way, farthest),
        overlap_mm3=overlap_mm3(solids),
        blocked=_blocked(printed, solids, sizes),
        face_deviation_mm=float(np.abs(reach - sizes.kernel_mm).max()),
    )


def _blocked(
    printed: ProbeParts, solids: Sequence[Manifold | None], sizes: ProbeSizes
) -> tuple[str, ...]:
    """Kernel, then upper half, brought in along the split's way."""
    return tuple(
        part.name
        for place, part in enumerate(printed.parts)
        if place
        and meets_on_its_way(solids[:place], solids[place], printed.split.way_in, sizes.wall_mm / 2)
    )


DIRECTIONS = 40_000  # over the sphere; a face's hemisphere holds half of them
_DISC = 0.25  # of a face's free radius, about its centre


@dataclass(frozen=True, kw_only=True, eq=False)
class Visibility:
    """``response`` A (n,n): int_cell j V_i(w) <n_i, w>+ dw, and the ideal of each face (n,)."""

    response: Float[Tensor, "n n"]
    facing: Float[Tensor, " n"]

    @property
    def loss(self) -> Float[Tensor, " n"]:
        """1 - A_ii / facing_i: the share of its own cell that a face does not get."""
        return 1 - self.response.diagonal() / self.facing

    @property
    def leak(self) -> Float[Tensor, " n"]:
        """sum_{j != i} A_ij / facing_i: what it gets from other cells."""
        return (self.response.sum(1) - self.response.diagonal()) / self.facing


def measure_visibility(
    cells: Cells,
    caster: Raycaster,
    *,
    centres: Float[np.ndarray, "n 3"],
    radii: Float[np.ndarray, " n"],
    rotation: Float[np.ndarray, "3 3"],
    directions: int = DIRECTIONS,
) -> Visibility:
    """From discs about the faces' centres, in the frame of the geometry.

    Each ray of a Hammersley set starts at another place of a disc of a quarter of the face's free
    radius. Of each cell the seen share is estimated, weighed by the cosine, and multiplied with
    the exact integral, which leaves no error of quadrature where all or nothing is seen.

    ``radii``: how far round the ``centres`` faces are flat and free; ``rotation``: from the probe's
    frame to that of the geometry.
    """
    grid = DirectionGrid.hammersley(directions).directions.double()
    owner = cells.cell_of(grid)
    exact = cells.clamped_cosine(cells.normals)
    turn = torch.from_numpy(rotation)
    number = torch.arange(directions, dtype=torch.float64)
    # the plastic number's sequence (Roberts 2018)
    u, v = (number * 0.7548776662466927) % 1, (number * 0.5698402909980532) % 1
    disc = (
        torch.stack([torch.cos(2 * torch.pi * v), torch.sin(2 * torch.pi * v)], 1)
        * u.sqrt()[:, None]
    )
    rows = []
    frames = torch.stack(tangents(cells.normals), 1)
    for cell, normal in enumerate(cells.normals):
        cosine = grid @ normal
        ahead = cosine > 0
        offset = _DISC * float(radii[cell]) * disc[ahead] @ frames[cell] + caster.epsilon * normal
        start = torch.from_numpy(centres[cell]) + offset @ turn.T
        free = ~caster.occluded(start, grid[ahead] @ turn.T)
        total = torch.zeros(cells.count, dtype=torch.float64)
        total.index_add_(0, owner[ahead], cosine[ahead])
        seen = torch.zeros_like(total).index_add_(0, owner[ahead], cosine[ahead] * free)
        share = torch.where(total > 0, seen / total.clamp(min=1e-12), 0.0)
        rows.append(share * exact[cell])
    return Visibility(response=torch.stack(rows), facing=cells.facing)


_HANGING = 2.0  # diameters of the shell, between it and the board


@dataclass(frozen=True, kw_only=True)
class PrintedPartitions(MountedPrint):
    """All that was made of a design: parts as assembled and on the bed, and as measured."""

    cells: Cells
    sizes: ProbeSizes
    printed: ProbeParts
    report: PartitionPrintReport
    visibility: Visibility
    assembly: PartitionAssembly
    face_radii_mm: Float[np.ndarray, " n"]

    @property
    def paper_hole_mm(self) -> float:
        return paper_hole_mm(
            self.pole, wall_mm=self.sizes.wall_mm, clearance_mm=self.sizes.clearance_mm
        )

    @property
    def rims_mm(self) -> Float[np.ndarray, "e 2"]:
        """See :func:`~skylight.probes.partitions.printed._solids.rim_halves`."""
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

    See :func:`~skylight.probes.partitions.printed._assembly.fitted_sizes`. Where no flare was
    named, rims are as wide as leaves nothing thinner than the walls. What does not fit is
    refused, with sizes that do.
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
    foot = Foot.of(WallNet.of(cells, rotation), sizes, pole.diameter_mm)
    translation = _over_board(foot, sizes, pole, board)
    printed = probe_parts(cells, sizes, rotation=rotation, pole_mm=pole.diameter_mm)
    x, z = foot.axis
    pole_mm = (
        float(x + translation[0]),
        float(z + translation[2]),
        pole.diameter_mm / 2,
        float(foot.top_mm + translation[1]),
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
        bed=lay_out(lying_parts(printed)),
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
    foot: Foot, sizes: ProbeSizes, pole: Pole, board: MarkerBoard
) -> Float[np.ndarray, " 3"]:
    """From the standing probe's frame to the board's: the pole stands in its middle."""
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


def lying_parts(printed: ProbeParts) -> list[PrintedPart]:
    """Parts as they are printed: half shells on their cut, the kernel on its largest face."""
    way, normals = printed.split.way_in, printed.net.normals
    corners = printed.kernel.corners
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    along = cross @ normals.T / np.maximum(area, 1e-12)[:, None]
    widest = normals[int((area @ (along > 1 - 1e-6)).round(6).argmax())]
    return [
        replace(part, vertices=part.vertices @ frame_along(up).T, up=(0, 0, 1))
        for part, up in ((printed.lower, -way), (printed.upper, way), (printed.kernel, -widest))
    ]
