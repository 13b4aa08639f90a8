"""Cost of four algorithms for the gradient over degree, rows, twists and filters.

    python -m tools.measure_correlation_growth

Writes ``benchmarks/results/correlation-growth.json`` and ``docs/images/correlation_growth.png``.
One of the four numbers is varied at a time, from 40, 16, 16 and 50; exponents are the slopes of
straight lines through the logarithms. Filters have no symmetry, but for the isotropic method.
Processor seconds on one thread, so that other work on the machine counts little: medians of 7 runs
after a warm-up. Rotated zonal harmonics take seconds: they run once, cold, and not at K = 60.
"""

import argparse
import platform
import statistics
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import numpy as np
import torch
from matplotlib import pyplot as plt
from torch import Tensor

from skylight.csc._positions import Positions
from skylight.csc._wigner import RotationCorrelation
from skylight.evaluation._main import commit
from skylight.io._atomic import atomic_path
from skylight.io._bounded import write_json
from tools.thesis_gradients import IsotropicGradient, RotatedResiduals, RotatedZonalGradient

BASE = {"degree": 40, "rows": 16, "twists": 16, "filters": 50}
VARIED = {
    "degree": [10, 20, 40, 60],
    "rows": [8, 16, 32],
    "twists": [8, 16, 32],
    "filters": [10, 50, 200],
}
METHODS: dict[str, Callable] = {
    "default: FFTs on SO(3)": RotationCorrelation,
    "isotropic (6.4.3)": IsotropicGradient,
    "rotated residuals (6.4.4)": RotatedResiduals,
    "rotated zonal harmonics (6.4.5)": RotatedZonalGradient,
}
REPEATS = {RotatedZonalGradient: 1}  # it takes seconds
MOST_REPEATS = 7
LARGEST_DEGREE = {RotatedZonalGradient: 40}  # 60 would take half a minute


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--out", type=Path, default=Path("benchmarks/results/correlation-growth.json")
    )
    parser.add_argument("--picture", type=Path, default=Path("docs/images/correlation_growth.png"))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    known: dict[tuple[str, tuple[int, ...]], float] = {}
    panels = {}
    for varied, values in VARIED.items():
        panels[varied] = {name: _curve(name, varied, values, known) for name in METHODS}
    content = {
        "command": "python -m tools.measure_correlation_growth",
        "commit": commit(),
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "machine": f"{platform.machine()}, torch {torch.__version__}, 1 thread, "
        "shared with other work: processor seconds",
        "base": BASE,
        "dtype": "float32",
        "repeats": {
            name: REPEATS.get(method, MOST_REPEATS)  # type: ignore[call-overload]
            for name, method in METHODS.items()
        },
        "seconds": panels,
    }
    write_json(arguments.out, content)
    _draw(panels, arguments.picture)


def _curve(
    name: str, varied: str, values: list[int], known: dict[tuple[str, tuple[int, ...]], float]
) -> dict:
    """Medians in seconds where ``varied`` has these values, and the exponent."""
    method = METHODS[name]
    points = [
        v for v in values if varied != "degree" or v <= LARGEST_DEGREE.get(method, max(values))
    ]
    seconds = []
    for value in points:
        setting = BASE | {varied: value}
        key = (name, tuple(setting.values()))
        if key not in known:
            known[key] = _seconds(method, **setting)
            print(f"{name}: {setting}: {known[key]:.4f} s", flush=True)
        seconds.append(known[key])
    exponent = float(np.polyfit(np.log(points), np.log(seconds), 1)[0])
    return {"values": points, "seconds": seconds, "exponent": exponent}


def _seconds(method: Callable, *, degree: int, rows: int, twists: int, filters: int) -> float:
    generator = torch.Generator().manual_seed(0)
    bank = torch.randn(filters, (degree + 1) ** 2, generator=generator, dtype=torch.float64)
    if method is IsotropicGradient:
        l = torch.arange(degree + 1)  # noqa: E741
        bank = torch.zeros_like(bank).index_copy_(1, l * (l + 1), bank[:, l * (l + 1)])
    bank = torch.nn.functional.normalize(bank, dim=1)
    residual = torch.randn((degree + 1) ** 2, generator=generator)
    correlate = method(bank, Positions(rows=rows, twists=twists))
    repeats = REPEATS.get(method, MOST_REPEATS)  # type: ignore[call-overload]
    if repeats > 1:
        _timed(correlate, residual)  # warm-up
    return statistics.median(_timed(correlate, residual) for _ in range(repeats))


def _timed(correlate: Callable[[Tensor], Tensor], residual: Tensor) -> float:
    begin = time.process_time()
    correlate(residual)
    return time.process_time() - begin


def _draw(panels: dict[str, dict[str, dict]], path: Path) -> None:
    names = {"degree": "degree K", "rows": "rows", "twists": "twists", "filters": "filters"}
    figure, axes = plt.subplots(2, 2, figsize=(10, 8), layout="constrained", sharey=True)
    for ax, (varied, curves) in zip(axes.flat, panels.items(), strict=True):
        for name, curve in curves.items():
            label = f"{name}: {curve['exponent']:.1f}"
            ax.loglog(curve["values"], curve["seconds"], "o-", label=label)
        ax.set_xticks(VARIED[varied], [str(v) for v in VARIED[varied]])
        ax.minorticks_off()
        fixed = ", ".join(f"{v} {names[k]}" for k, v in BASE.items() if k not in (varied, "degree"))
        ax.set_title(fixed if varied == "degree" else f"K = {BASE['degree']}, {fixed}", fontsize=9)
        ax.set_xlabel(names[varied])
        ax.set_ylabel("processor seconds, 1 gradient")
        ax.grid(alpha=0.3)
        # above the curves, where the shared axis leaves room
        ax.legend(title="exponent", fontsize=7, title_fontsize=7, loc="upper left")
    low, high = axes[0, 0].get_ylim()
    axes[0, 0].set_ylim(low, high * 30)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=120, format="png")
    plt.close(figure)


if __name__ == "__main__":
    main()
