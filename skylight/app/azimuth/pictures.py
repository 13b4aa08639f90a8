"""The figure from which a person chooses the azimuth of a probe."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

from jaxtyping import Float
from torch import Tensor

from skylight.app.figures.exposure import white_of
from skylight.app.figures.panels import show
from skylight.app.figures.style import ACCENT, INK, MUTED, STYLE, save
from skylight.faces.observe import FaceView
from skylight.imaging.colour import tone_map
from skylight.imaging.photo import Photo
from skylight.inverse.azimuth import AzimuthCurve, relit_face
from skylight.sphere.envmap import EnvironmentMap, luminance
from skylight.sphere.frame import pixel_from_direction

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FEWEST_COLUMNS = 3  # a lone minimum is drawn no larger than one of two
PROBE_QUANTILE = 0.9  # shown as white: clouds and ground tell more than the sun, which is white


def write_choice(
    path: Path,
    title: str,
    photo: Photo,
    view: FaceView,
    probe: EnvironmentMap,
    curve: AzimuthCurve,
) -> None:
    """The curve with its numbered minima; for each the relit face and the turned probe."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    columns = max(FEWEST_COLUMNS, 1 + len(curve.minima))
    white = white_of(view.observation.pixels)
    with rc_context(STYLE):
        figure = Figure(figsize=(4 * columns, 12), dpi=80, facecolor="white")
        figure.text(0.02, 0.965, f"Azimuth of the probe of {title}", fontsize=17, weight="bold")
        rows = figure.add_gridspec(
            2, 1, height_ratios=(1, 1.75), left=0.02, right=0.98, top=0.92, bottom=0.03, hspace=0.2
        )
        above = rows[0].subgridspec(1, 2, width_ratios=(1, columns - 1), wspace=0.1)
        show(figure.add_subplot(above[0]), photo.encoded, "Photograph")
        _curve(figure.add_subplot(above[1]), curve)
        below = rows[1].subgridspec(2, columns, height_ratios=(2, 1), wspace=0.06, hspace=0.12)
        show(figure.add_subplot(below[0, 0]), tone_map(view.image, white=white), "Face as seen")
        for number, index in enumerate(curve.minima, start=1):
            turn = float(curve.azimuth_deg[index])
            relit = _pasted(view, relit_face(view.observation, probe, turn))
            title = f"{number}:  {turn:+.1f}°, si-RMSE {float(curve.error[index]):.3f}"
            show(figure.add_subplot(below[0, number]), tone_map(relit, white=white), title)
            _probe(figure.add_subplot(below[1, number]), probe, turn)
        save(figure, path)


def _curve(axes: "Axes", curve: AzimuthCurve) -> None:
    axes.plot(curve.azimuth_deg, curve.error, color=INK, linewidth=1.6)
    for number, index in enumerate(curve.minima, start=1):
        at = float(curve.azimuth_deg[index]), float(curve.error[index])
        axes.plot(*at, marker="o", markersize=9, color=ACCENT)
        axes.annotate(
            str(number),
            at,
            xytext=(0, -20),
            textcoords="offset points",
            ha="center",
            color=ACCENT,
            fontsize=14,
            weight="bold",
        )
    axes.set_title("si-RMSE of the relit face over the turn of the probe, degrees to the right")
    axes.set_xlim(-180, 180)
    axes.set_xticks(range(-180, 181, 45))
    axes.margins(y=0.2)
    axes.grid(color=MUTED, alpha=0.25)


def _probe(axes: "Axes", probe: EnvironmentMap, turn_deg: float) -> None:
    """The turned probe, its brightest spot ringed; the camera looks at the line."""
    turned = probe.rotate_azimuth(math.radians(turn_deg))
    show(axes, tone_map(turned.radiance, quantile=PROBE_QUANTILE), "")
    axes.axvline(turned.layout[1] / 2 - 0.5, color="white", linewidth=0.9, alpha=0.7)
    row, column = pixel_from_direction(turned.brightest_direction(), *turned.layout)
    axes.plot(
        float(column),
        float(row),
        marker="o",
        markersize=11,
        markerfacecolor="none",
        markeredgecolor=ACCENT,
        markeredgewidth=2,
    )


def _pasted(view: FaceView, pixels: Float[Tensor, "m 3"]) -> Float[Tensor, "h w 3"]:
    """The relit pixels over the picture in grey and half as bright."""
    canvas = (0.5 * luminance(view.image))[..., None].repeat(1, 1, 3)
    rows, columns = view.places.unbind(1)
    canvas[rows, columns] = pixels[view.blocks]
    return canvas
