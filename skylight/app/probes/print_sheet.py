"""The figure layout of printed probes, and the board on the marker base."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from manifold3d import Manifold

from skylight.app.figures.panels import show, write_numbers
from skylight.app.figures.style import ACCENT, MUTED, STYLE, save
from skylight.fabrication.mount import MarkerBoard
from skylight.fabrication.part import PrintedPart, box, part_of

# linear reflectances
BASE, POLE = (0.55, 0.58, 0.62), (0.75, 0.76, 0.78)
PAPER, INK = (0.9, 0.9, 0.9), (0.05, 0.05, 0.05)
PANEL_PX = 600
_PATTERN = 7  # squares along the board's longer side in the picture


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
