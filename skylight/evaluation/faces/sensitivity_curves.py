"""Figures of the sensitivity analysis: Figs. 5.8 and B.5 to B.7 with the thesis' curves."""

from pathlib import Path

from skylight.evaluation.harness.pictures import NAMES
from skylight.evaluation.harness.tables import LABELS
from skylight.evaluation.harness.thesis_figures import METRICS
from skylight.io.atomic import atomic_path

Curves = dict[str, dict[str, dict[str, list[tuple[float, float]]]]]
_CURVE_AXES = {
    "size": "side of the picture, pixels",
    "pose": "pose error, degrees (mean of both axes)",
    "shape": "noise of the shape, standard deviations",
}
_FIGURES = {"size": "figure_b_5", "pose": "figure_b_6", "shape": "figure_b_7"}
_HEADLINE = "full_dw_mae"


def write_sensitivity(out: Path, curves: Curves) -> list[Path]:
    """Full-dω MAE over each factor (``figure_5_8.png``), and all metrics over one factor each."""
    there = [factor for factor in _CURVE_AXES if factor in curves]
    written = [_write(out / "figure_5_8.png", [(factor, _HEADLINE) for factor in there], curves, 1)]
    for factor in there:
        panels = [(factor, metric) for metric in METRICS if metric in curves[factor]]
        written.append(_write(out / f"{_FIGURES[factor]}.png", panels, curves, 2))
    return written


def _write(path: Path, panels: list[tuple[str, str]], curves: Curves, rows: int) -> Path:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    columns = -(-len(panels) // rows)
    figure, axes = plt.subplots(
        rows, columns, figsize=(4 * columns, 3.4 * rows), squeeze=False, layout="constrained"
    )
    for place, (factor, metric) in zip(axes.flat, panels, strict=False):
        for method, points in curves[factor][metric].items():
            place.plot(*zip(*points, strict=True), marker="o", ms=3, label=NAMES[method])
        place.set_xlabel(_CURVE_AXES[factor])
        place.set_title(LABELS[metric], fontsize=10)
        place.set_ylim(bottom=0)
        place.grid(alpha=0.3)
    for place in axes.flat[len(panels) :]:
        place.axis("off")
    axes.flat[0].legend(fontsize=8)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110)
    plt.close(figure)
    return path
