"""The report of a printed probe: measurements of its parts, what is out of tolerance, a figure."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from manifold3d import Manifold

from skylight._figures import ACCENT, MUTED, STYLE, save, show, write_numbers
from skylight.probes.fabrication._mount import MarkerBoard
from skylight.probes.fabrication._parts import PrintedPart, PrintSizes, box, part_of

WALL_TOLERANCE_MM = 1e-3
PLAY_TOLERANCE_MM = 1e-3
FACE_TOLERANCE_MM = 1e-6
VOLUME_TOLERANCE_MM3 = 1e-3  # a face of 30 mm off by 1e-6 mm
# linear reflectances
BASE, POLE = (0.55, 0.58, 0.62), (0.75, 0.76, 0.78)
PAPER, INK = (0.9, 0.9, 0.9), (0.05, 0.05, 0.05)
PANEL_PX = 600
_PATTERN = 7  # squares along the board's longer side in the picture


@dataclass(frozen=True, kw_only=True)
class PartFigures:
    """One part; ``overhang_mm2`` faces down flatter than 45 degrees, ``bridge_mm`` long."""

    name: str
    watertight: bool
    consistent: bool
    pieces: int
    volume_mm3: float
    thinnest_mm: float
    overhang_mm2: float
    bridge_mm: float


@dataclass(frozen=True, kw_only=True)
class FileFigures:
    """An STL file, read back; ``watertight``: closed in float32, with vertices told by place."""

    name: str
    triangles: int
    watertight: bool
    volume_mm3: float


@dataclass(frozen=True, kw_only=True)
class JointFigures:
    """How far a part moves on its collar: sideways, and further on (0: it is at its stop)."""

    carrier: str
    plugged: str
    clearances_mm: tuple[float, ...]
    stop_mm: float


@dataclass(frozen=True, kw_only=True)
class ContactFigures:
    """The gap between two parts that lie side by side without a joint."""

    first: str
    second: str
    gap_mm: float


@dataclass(frozen=True, kw_only=True)
class MeasuredParts(ABC):
    """Figures that all printed probes have; ``problems`` is empty where all is well."""

    parts: tuple[PartFigures, ...]
    overlap_mm3: float
    blocked: tuple[str, ...]
    face_deviation_mm: float

    @property
    @abstractmethod
    def clearances_mm(self) -> tuple[float, float]:
        """(least, largest) of all that meets."""

    @property
    @abstractmethod
    def problems(self) -> tuple[str, ...]:
        """One line for each verdict that fails."""

    @property
    def thinnest_mm(self) -> float:
        return min(part.thinnest_mm for part in self.parts)

    @property
    def sound(self) -> bool:
        return not self.problems

    def content(self) -> dict[str, object]:
        """For a JSON file."""
        least, largest = self.clearances_mm
        return {
            "sound": self.sound,
            "problems": list(self.problems),
            "thinnest_wall_mm": self.thinnest_mm,
            "least_clearance_mm": least,
            "largest_clearance_mm": largest,
            **asdict(self),
        }

    def _part_problems(self, wall_mm: float) -> list[str]:
        return [line for part in self.parts for line in part_problems(part, wall_mm)]

    def _fit_problems(self) -> list[str]:
        """Parts that are in one another, or in one another's way."""
        found = []
        if not self.overlap_mm3 <= VOLUME_TOLERANCE_MM3:
            found.append(f"assembled parts share {self.overlap_mm3:.3g} mm3")
        return found + [f"{name}: meets an earlier part on its way in" for name in self.blocked]


def clearance_problems(name: str, found_mm: Iterable[float], clearance_mm: float) -> list[str]:
    """One line where a gap is below the clearance, or above twice that."""
    low, high = clearance_mm - PLAY_TOLERANCE_MM, 2 * clearance_mm + PLAY_TOLERANCE_MM
    worst = [mm for mm in found_mm if not low <= mm <= high]
    return [f"{name}: clearance {worst[0]:.3f} mm"] if worst else []


@dataclass(frozen=True, kw_only=True)
class PrintReport(MeasuredParts):
    """Figures of a voxel probe's parts and of their assembly."""

    sizes: PrintSizes
    joints: tuple[JointFigures, ...]
    contacts: tuple[ContactFigures, ...]
    outside_mm3: float

    @property
    def clearances_mm(self) -> tuple[float, float]:
        """(least, largest) of all joints and contacts."""
        every = [c for joint in self.joints for c in joint.clearances_mm]
        every += [contact.gap_mm for contact in self.contacts]
        return min(every), max(every)

    @property
    def problems(self) -> tuple[str, ...]:
        """One line for each verdict that fails."""
        found = self._part_problems(self.sizes.wall_mm)
        low = self.sizes.clearance_mm - PLAY_TOLERANCE_MM
        high = 2 * self.sizes.clearance_mm + PLAY_TOLERANCE_MM
        for joint in self.joints:
            name = f"{joint.plugged} on {joint.carrier}"
            found += clearance_problems(name, joint.clearances_mm, self.sizes.clearance_mm)
            if joint.stop_mm > PLAY_TOLERANCE_MM:
                found.append(f"{name}: goes {joint.stop_mm:.3f} mm too far on")
        for contact in self.contacts:
            if not low <= contact.gap_mm <= high:
                found.append(
                    f"{contact.first} beside {contact.second}: gap {contact.gap_mm:.3f} mm"
                )
        found += self._fit_problems()
        if not self.face_deviation_mm <= FACE_TOLERANCE_MM:
            found.append(f"outer faces are up to {self.face_deviation_mm:.3g} mm off the model's")
        if not self.outside_mm3 <= VOLUME_TOLERANCE_MM3:
            found.append(f"{self.outside_mm3:.3g} mm3 of the parts stick out of the model")
        return tuple(found)


def part_problems(part: PartFigures, wall_mm: float) -> list[str]:
    """One line for each verdict on a single part that fails."""
    found = []
    if not part.watertight:
        found.append("has a hole, or touches itself along an edge")
    if not part.consistent:
        found.append("has triangles that are turned the other way")
    if part.pieces != 1:
        found.append(f"is in {part.pieces} pieces")
    if part.volume_mm3 <= 0:
        found.append("is inside out")
    if part.thinnest_mm < wall_mm - WALL_TOLERANCE_MM:
        found.append(f"has a wall of {part.thinnest_mm:.3f} mm")
    return [f"{part.name}: {problem}" for problem in found]


def write_sheet_of_prints(
    path: Path,
    *,
    title: str,
    sizes: str,
    problems: Sequence[str],
    panels: Mapping[str, UInt8[np.ndarray, "_ _ 3"]],
    rows: list[tuple[str, str]],
    panel_px: int,
) -> None:
    """Write a PNG of three panels, ``panel_px`` high, and a table of numbers."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=(15.2, 13.2), dpi=84 * panel_px / PANEL_PX, facecolor="white")
        figure.text(0.02, 0.967, f"{title}, to print", fontsize=17, fontweight="bold")
        figure.text(0.98, 0.97, sizes, ha="right", color=MUTED, fontsize=11.5)
        if problems:
            text = "Take care: " + "; ".join(problems[:3])
            figure.text(0.02, 0.948, text, color=ACCENT)
        grid = figure.add_gridspec(
            2, 2, left=0.02, right=0.98, top=0.925, bottom=0.02, wspace=0.04, hspace=0.09
        )
        for place, (name, picture) in enumerate(panels.items()):
            axes = figure.add_subplot(grid[place // 2, place % 2])
            show(axes, picture, name)
            axes.images[0].set_interpolation("bilinear")  # panels are not to the pixel
            for spine in axes.spines.values():
                spine.set_visible(False)
        numbers = figure.add_subplot(grid[1, 1].subgridspec(1, 3, width_ratios=(0.1, 1, 0.1))[1])
        write_numbers(numbers, "In numbers", rows)
        save(figure, path)


def paper_parts(board: MarkerBoard, hole_mm: float) -> list[PrintedPart]:
    """The paper and its dark squares, pierced by the base's socket; a picture, not the pattern."""
    side = max(board.width_mm, board.height_mm) / _PATTERN
    hole = hole_mm / 2
    centre = (board.width_mm / 2, board.height_mm / 2, -1.0)
    cut = Manifold.cylinder(3.0, hole, hole, 48).translate(centre)
    margin = board.margin_mm
    sheet = box(
        np.array([-margin, -margin, 0.0]),
        np.array([board.width_mm + margin, board.height_mm + margin, board.paper_mm]),
    )
    squares = []
    for row in range(round(board.height_mm / side)):
        for column in range(row % 2, round(board.width_mm / side), 2):
            low = np.array([column * side, row * side, -0.05])
            squares.append(box(low, low + np.array([side, side, 0.1])) - cut)
    return [part_of("paper", sheet - cut), *(part_of("square", s) for s in squares if s.num_tri())]
