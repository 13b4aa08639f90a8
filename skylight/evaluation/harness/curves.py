"""Plots of metrics measured at several counts: ``l2_4``, ``l2_16``, ..."""

import re
from pathlib import Path

from skylight.evaluation.harness.tables import LABELS, Rows
from skylight.io.atomic import atomic_path

_AT_COUNT = re.compile(r"(.+)_(\d+)")


def curves_of(rows: Rows) -> dict[str, dict[str, list[tuple[int, float]]]]:
    """Metric without its count -> method -> (count, mean), for methods with two counts or more."""
    found: dict[str, dict[str, dict[int, float]]] = {}
    for method, metrics in rows.items():
        for metric, statistics in metrics.items():
            match = _AT_COUNT.fullmatch(metric)
            if match:
                curve = found.setdefault(match[1], {}).setdefault(method, {})
                curve[int(match[2])] = statistics["mean"]
    return {
        metric: {m: sorted(c.items()) for m, c in methods.items() if len(c) > 1}
        for metric, methods in found.items()
    }


def write_curves(out: Path, rows: Rows) -> list[Path]:
    """A picture ``METRIC.png`` for each metric that has curves; returns them."""
    written = []
    for metric, methods in curves_of(rows).items():
        if not methods:
            continue
        import matplotlib

        matplotlib.use("Agg")
        import matplotlib.pyplot as plt

        figure, axes = plt.subplots(figsize=(8, 6), constrained_layout=True)
        for number, (method, curve) in enumerate(methods.items()):
            style = ("-", "--", ":")[number // 10 % 3]
            axes.plot(*zip(*curve, strict=True), style, marker="o", ms=3, label=method)
        axes.set_xscale("log")
        axes.set_xlabel("activations, coefficients or lobes")
        axes.set_ylabel(LABELS.get(metric, metric))
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize=7, ncols=2)
        path = out / f"{metric}.png"
        with atomic_path(path) as temporary:
            figure.savefig(temporary, dpi=110)
        plt.close(figure)
        written.append(path)
    return written
