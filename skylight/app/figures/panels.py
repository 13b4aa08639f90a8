"""Panels of figures: images, environment maps, tables of numbers."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8

from skylight.app.figures.style import ACCENT, MUTED
from skylight.imaging.colour import tone_map
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.frame import pixel_from_direction

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def show(axes: "Axes", picture: UInt8[np.ndarray, "h w 3"], title: str) -> None:
    """A picture without ticks under its title."""
    axes.imshow(picture, interpolation="nearest")
    axes.set_title(title)
    axes.set_anchor("NW")
    axes.set_xticks([])
    axes.set_yticks([])


def show_probe(
    axes: "Axes", environment: EnvironmentMap, title: str, *, white: float | None = None
) -> None:
    """A full lat-long map with its axes named and its brightest direction ringed."""
    height, width = environment.layout
    show(axes, tone_map(environment.radiance, white=white), title)
    axes.set_xticks(
        [(turn + 0.5) * width - 0.5 for turn in (-0.5, -0.25, 0, 0.25, 0.5)],
        ["behind", "left", "where the camera looks", "right", "behind"],
    )
    labels = axes.get_xticklabels()
    labels[0].set_horizontalalignment("left")
    labels[-1].set_horizontalalignment("right")
    axes.axhline(height / 2 - 0.5, color="white", linewidth=0.9, alpha=0.7, linestyle=(0, (4, 4)))
    axes.text(0.5, height / 2, "horizon", color="white", fontsize=9, va="top", alpha=0.9)
    sun = environment.brightest_direction()
    row, column = (float(value) for value in pixel_from_direction(sun, height, width))
    # a dark ring under the bright one shows on any sky
    for color, line in (("black", 4.0), (ACCENT, 2.2)):
        axes.plot(
            column,
            row,
            marker="o",
            markersize=17,
            markerfacecolor="none",
            markeredgecolor=color,
            markeredgewidth=line,
            clip_on=False,
        )
    on_right = column > 0.75 * width
    axes.annotate(
        "brightest",
        (column, row),
        xytext=(-13 if on_right else 13, -15 if row < height / 4 else 11),
        textcoords="offset points",
        ha="right" if on_right else "left",
        va="center",
        color="white",
        fontsize=10,
        fontweight="bold",
        bbox={"boxstyle": "round,pad=0.25", "facecolor": ACCENT, "edgecolor": "none"},
    )


def write_numbers(
    axes: "Axes", title: str, rows: list[tuple[str, str]], *, pitch: float = 0.053
) -> None:
    """A table of names and values, ``pitch`` of the axes' height apart."""
    axes.set_axis_off()
    axes.set_title(title)
    for place, (name, value) in enumerate(rows):
        y = 1 - pitch * (place + 0.95)
        axes.text(0, y, name, color=MUTED, transform=axes.transAxes)
        axes.text(1, y, value, transform=axes.transAxes, ha="right")
