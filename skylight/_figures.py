"""What figures and reports share: style, panels of maps, lamps in words, the evaluation scene."""

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.imaging._colour import tone_map
from skylight.inverse._result import Lamp
from skylight.io._atomic import atomic_path
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import angles_from_direction, pixel_from_direction
from skylight.transport._scene import EvaluationScene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


INK, MUTED, ACCENT = "#1d2733", "#6b7785", "#e4572e"
STYLE: dict[Any, Any] = {  # matplotlib types the keys as its own literals
    "font.family": "DejaVu Sans",
    "font.size": 10.5,
    "text.color": INK,
    "axes.edgecolor": "#c5ccd3",
    "axes.titlesize": 11.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlecolor": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 9.5,
    "ytick.labelsize": 9.5,
}


def save(figure: "Figure", path: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    drawn = io.BytesIO()  # so that only the disk can fail while the file is open
    # the default level takes half as long again for 4 % less
    figure.savefig(drawn, format="png", pil_kwargs={"compress_level": 3})
    with atomic_path(path) as temporary:
        temporary.write_bytes(drawn.getvalue())


def show(axes: "Axes", picture: UInt8[np.ndarray, "h w 3"], title: str) -> None:
    """A picture without ticks under its title."""
    axes.imshow(picture, interpolation="nearest")
    axes.set_title(title)
    axes.set_anchor("NW")
    axes.set_xticks([])
    axes.set_yticks([])


def show_probe(
    axes: "Axes",
    environment: EnvironmentMap,
    title: str,
    *,
    white: float | None = None,
    main: Float[Tensor, "3"] | None = None,
) -> None:
    """A full lat-long map with its axes named and ``main`` ringed, by default its brightest
    direction."""
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
    sun = environment.brightest_direction() if main is None else main
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


def angles_deg(direction: Float[Tensor, "3"]) -> tuple[float, float]:
    """(azimuth, zenith) of a direction, degrees."""
    azimuth, zenith = angles_from_direction(direction)
    return math.degrees(float(azimuth)), math.degrees(float(zenith))


def named_angles(direction: Float[Tensor, "3"]) -> dict[str, float]:
    """:func:`angles_deg` as estimate.json has them."""
    return dict(zip(("azimuth_deg", "zenith_deg"), angles_deg(direction), strict=True))


def describe_lamps(lamps: Sequence[Lamp]) -> list[dict[str, object]]:
    """What estimate.json says of them."""
    return [
        {
            **named_angles(lamp.direction),
            "irradiance": lamp.irradiance.tolist(),
            "spread_deg": math.degrees(lamp.spread_rad),
        }
        for lamp in lamps
    ]


def white_of(values: Float[Tensor, "m 3"]) -> float:
    """The luminance to show as white: a little above nearly all."""
    return max(1.05 * float(torch.quantile(luminance(values.float()), 0.98)), 1e-30)


SCENE_HEIGHT, SCENE_GRID = 144, 32  # for looking at: twice the scores' pixels, as much memory


def relit(
    scene: EvaluationScene, environment: EnvironmentMap, *, like: EnvironmentMap | None = None
) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]:
    """(diffuse, metal objects) in this light, exposed for them or as in the light ``like``."""
    diffuse, metal = scene.relight(environment), scene.relight_specular(environment)
    diffuse_like = diffuse if like is None else scene.relight(like)
    metal_like = metal if like is None else scene.relight_specular(like)
    rows, columns = scene.diffuse.pixels.unbind(1)
    return (
        tone_map(diffuse, white=white_of(diffuse_like[rows, columns])),
        tone_map(metal, white=white_of(metal_like.reshape(-1, 3))),
    )
