"""The figure of a merged probe: the ball's outline, the map at two exposures, and numbers."""

from pathlib import Path
from typing import TYPE_CHECKING

from skylight.app.figures.panels import show, show_probe, write_numbers
from skylight.app.figures.style import ACCENT, STYLE, save
from skylight.imaging.colour import tone_map
from skylight.probes.mirror_balls.merged import MergedProbe
from skylight.sphere.envmap import luminance

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DARKER = 16.0  # the second exposure of the map, against the first


def write_merge_report(path: Path, result: MergedProbe) -> None:
    """The ball's outline in the pictures, the map at two exposures, and numbers, as PNG."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    environment = result.probe.environment
    values = luminance(environment.flat)
    white = float(values.kthvalue(round(0.85 * len(values))).values)
    with rc_context(STYLE):
        figure = Figure(figsize=(16, 10.2), dpi=120, facecolor="white")
        figure.text(0.02, 0.962, "Light merged from exposures", fontsize=17, fontweight="bold")
        if result.clipping is not None:
            care = f"Take care: {result.clipping.sentence()}"
            figure.text(0.02, 0.936, care, color=ACCENT, fontsize=9.5)
        grid = figure.add_gridspec(
            2, 2, width_ratios=(1, 1.55), left=0.02, right=0.98, top=0.9, bottom=0.045
        )
        left = grid[:, 0].subgridspec(len(result.views) + 1, 1, hspace=0.16)
        for number, shots in enumerate(result.views):
            axes = figure.add_subplot(left[number])
            name = shots.files[0].name
            show(axes, tone_map(shots.merged.radiance, quantile=0.95), f"Merged from {name} on")
            if result.outlines:
                _outline(axes, result, number)
        write_numbers(figure.add_subplot(left[-1]), "In numbers", _numbers(result), pitch=0.085)
        show_probe(figure.add_subplot(grid[0, 1]), environment, "The map", white=white)
        dark = f"{_DARKER:g} times darker"
        show_probe(figure.add_subplot(grid[1, 1]), environment, dark, white=_DARKER * white)
        save(figure, path)


def _outline(axes: "Axes", result: MergedProbe, number: int) -> None:
    points = result.outlines[number].ball.outline()
    # matplotlib counts from pixel centres
    axes.plot(*(points.T - 0.5), color=ACCENT, linewidth=1.4)


def _numbers(result: MergedProbe) -> list[tuple[str, str]]:
    rows = []
    for shots in result.views:
        if shots.seconds is not None:
            low, high = min(shots.seconds), max(shots.seconds)
            times = f"{len(shots.seconds)}, {low:.3g} to {high:.3g} s"
            rows.append(("exposures", times))
        if shots.merged.disagreement is not None:
            rows.append(("they disagree by", f"{100 * shots.merged.disagreement:.1f} %"))
    response = result.views[0].merged.response
    rows.append(("response", "linear" if response is None else response.kind))
    for outline in result.outlines:
        x, y, radius = outline.ball.circle
        rows.append(("ball's middle, radius", f"{x:.1f}, {y:.1f}, {radius:.1f} px"))
    if result.turn is not None:
        rows.append(("second camera looked to", f"{result.turn.azimuth_deg:.1f}° azimuth"))
    rows.append(("not seen", f"{100 * result.probe.unseen_share:.2g} % of the sphere"))
    clipped = 0.0 if result.clipping is None else result.clipping.solid_angle_sr
    rows.append(("saturated in all exposures", f"{clipped:.2g} sr"))
    return rows
