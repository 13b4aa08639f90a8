"""Figs. 6.8 and 6.9: error and similarity over activations, indoors."""

from pathlib import Path

from skylight.evaluation.harness.curves import curves_of
from skylight.evaluation.harness.tables import Rows
from skylight.io.atomic import atomic_path

_COLOURS = {"iso": "C0", "ani": "C1", "kmeans": "C2", "vmf": "C3", "box": "C4"}
_OTHERS = {"sh": "0.1", "sh_windowed": "0.45", "haar": "0.7", "sg": "C5"}
_PANELS = (("l2", "_k40"), ("l2", ""), ("ssim", "_k40"), ("ssim", ""))
_LABELS = {"l2": "relative L2 error", "ssim": "SSIM"}


def write_sparse_curves(path: Path, rows: Rows) -> None:
    """Coders of 40 bands on the left, with sharper filters on the right; NNLS dashed."""
    from matplotlib.figure import Figure

    curves = curves_of(rows)
    figure = Figure(figsize=(11, 8.5), layout="constrained")
    for axes, (metric, bands) in zip(figure.subplots(2, 2).flat, _PANELS, strict=True):
        for method, curve in curves[metric].items():
            dictionary, _, sign = method.replace("_k40", "").rpartition("_")
            coder = dictionary in _COLOURS and sign in ("nnls", "l1")
            if coder and method == f"{dictionary}{bands}_{sign}":
                style = {"color": _COLOURS[dictionary], "ls": "--" if sign == "nnls" else "-"}
            elif method in _OTHERS:
                style = {"color": _OTHERS[method], "ls": "-."}
            else:
                continue
            axes.plot(*zip(*curve, strict=True), marker="o", ms=3, label=method, **style)
        axes.set_xscale("log")
        axes.set(xlabel="activations, coefficients or lobes", ylabel=_LABELS[metric])
        axes.set_title("40 bands" if bands else "with sharper filters", fontsize=10)
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize=7, ncols=2)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=80, format="png")
