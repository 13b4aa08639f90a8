"""Results summarised: means over items, Markdown tables and plots.

Beside them stand Tables 5.1 to 5.3 of the thesis ("From Faces to Outdoor Light Probes"), as
printed: mean and standard deviation of seven metrics for each light model.
:mod:`skylight.imaging._metrics` says how each metric is computed here.
"""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from skylight.evaluation._pictures import save_figure
from skylight.evaluation._run import Item, Rows

METRICS = ("mae", "rmse", "si_rmse", "full_dw_mae", "sky_dw_mae", "sun_dw_mae", "sun_angle_deg")


@dataclass(frozen=True, kw_only=True)
class ThesisTable:
    """One printed table: cells of each method in the order of METRICS, "mean±deviation"."""

    title: str
    rows: dict[str, str]

    def cell(self, method: str, metric: str) -> tuple[float, float]:
        """(mean, deviation)."""
        mean, deviation = self.rows[method].split()[METRICS.index(metric)].split("±")
        return float(mean), float(deviation)


TABLE_5_1 = ThesisTable(
    title="The thesis, Table 5.1 (mean ± standard deviation over 135 captured skies)",
    rows={
        "sh9": "0.56±0.62 0.64±0.69 0.50±0.53 0.47±0.26 0.46±0.25 0.43±0.26 20.29±22.64",
        "sh25": "0.53±0.62 0.62±0.70 0.48±0.53 0.41±0.26 0.45±0.25 0.42±0.26 13.93±14.39",
        "sunsky": "0.54±0.43 0.37±0.28 0.23±0.21 0.40±0.18 0.18±0.14 0.06±0.10 0.68±1.52",
        "autoencoder_feedforward": (
            "1.54±4.69 1.05±3.06 0.14±0.16 0.50±0.70 0.23±0.27 0.10±0.10 4.61±13.63"
        ),
        "autoencoder": "0.35±0.32 0.29±0.29 0.17±0.19 0.30±0.21 0.22±0.22 0.16±0.20 6.52±14.51",
    },
)
TABLE_5_2 = ThesisTable(
    title="The thesis, Table 5.2 (mean ± standard deviation over 135 faces)",
    rows={
        "sh9": "0.68±0.39 0.53±0.30 0.41±0.22 1.04±0.48 0.43±0.23 0.35±0.20 18.31±19.52",
        "sh25": "0.71±0.51 0.52±0.33 0.43±0.22 1.22±0.37 0.46±0.21 0.34±0.21 22.38±18.54",
        "sunsky": "0.92±0.56 0.71±0.47 0.55±0.39 1.42±1.57 0.64±0.42 0.26±0.20 42.23±30.31",
        "autoencoder": "0.75±0.38 0.60±0.33 0.45±0.29 0.80±0.27 0.62±0.32 0.15±0.12 23.55±21.75",
    },
)
TABLE_5_3 = ThesisTable(
    title="The thesis, Table 5.3 (mean ± standard deviation over 131 photographs)",
    rows={
        "sh9": "1.39±0.91 0.95±0.58 0.58±0.32 1.65±0.73 0.49±0.26 0.32±0.20 45.88±46.72",
        "sh25": "0.99±0.44 0.71±0.31 0.57±0.24 1.29±0.31 0.46±0.23 0.36±0.21 28.67±28.49",
        "sunsky": "1.11±0.75 0.85±0.64 0.53±0.24 1.73±1.75 1.25±1.57 0.64±1.36 41.58±36.48",
        "autoencoder": "0.86±0.36 0.65±0.29 0.49±0.18 1.22±0.34 0.86±0.36 0.19±0.11 33.30±30.20",
    },
)
# which evaluation's page shows which table
BESIDE = {
    "sky-models": TABLE_5_1,
    "synthetic-faces": TABLE_5_2,
    "rendered-faces": TABLE_5_2,
    "rendered-faces-hosek-wilkie": TABLE_5_2,
    "captured-faces": TABLE_5_3,
}

IN_CELLS = ", in 25 cells"  # a reading of ours: the thesis does not say how it compares suns
LABELS = {
    "mae": "MAE (s)",
    "rmse": "RMSE (s)",
    "si_rmse": "si-RMSE (s)",
    "mae_aligned": "MAE (s), brightness aligned",
    "rmse_aligned": "RMSE (s), brightness aligned",
    "brightness": "brightness of the light / truth",
    "ssim": "SSIM (s)",
    "full_dw_mae": "Full-dω MAE (l)",
    "sky_dw_mae": "Sky-dω MAE (l)",
    "sun_dw_mae": f"Sun-dω MAE (l){IN_CELLS}",
    "sun_dw_mae_fixed": "Sun-dω MAE (l), by pixel at the true sun",
    "sun_angle_deg": "Sun-ang (l), deg",
    "main_lamp_deg": "angle to the main lamp, deg",
    "lamps_found": "lamps found, of those with a fifth of the light",
    "whole_colour": "colour of the whole map, log units",
    "whole_level": "level of the whole map, log units",
    "lower_colour": "colour of the lower half, log units",
    "lower_level": "level of the lower half, log units",
    "log_radiance": "log radiance over the sphere, log units",
    "mirror_si_rmse": "si-RMSE, mirror sphere",
    "silver_si_rmse": "si-RMSE, silver sphere",
    "diffuse_si_rmse": "si-RMSE, diffuse sphere",
    "mirror_angle_deg": "colour, mirror sphere, deg",
    "silver_angle_deg": "colour, silver sphere, deg",
    "diffuse_angle_deg": "colour, diffuse sphere, deg",
    "pose_deg": "pose error, deg",
    "in_region": "true sun in the 90 % region",
    "region_sr": "90 % region of the sun, sr",
    "psnr": "tone-mapped PSNR, dB",
    "tone_mapped_ssim": "tone-mapped SSIM",
    "floats": "floats",
    "floats_per_activation": "floats per activation, indices included",
    "l2": "relative L2 error",
    "srgb_rmse": "RMSE of sRGB values, person",
    "srgb_psnr": "PSNR of sRGB values, person, dB",
    "srgb_ssim": "SSIM, person",
    "blotch": "blotch (99th percentile of the error over 9 x 9 pixels), person",
    "srgb_rmse_skin": "RMSE of sRGB values, skin",
    "srgb_psnr_skin": "PSNR of sRGB values, skin, dB",
    "srgb_ssim_skin": "SSIM, skin",
    "blotch_skin": "blotch, skin",
    "seconds": "seconds",
    "cpu_seconds": "seconds of a core",
    "photos_per_minute": "photographs a minute",
    "seconds_of_a_photo": "seconds of a photograph, by a worker",
    "transport_seconds": "seconds of ray tracing",
    "peak_mib": "peak memory of the process so far, MiB",
}
_COLUMNS = 8
GROUPED_BY = (
    "category",
    "background",
    "direction",
    "half",
    "regime",
    "skin tone",
)  # facts of which each value gets its own rows
_PEERS_METRICS = ("psnr", "tone_mapped_ssim")
_RENI_ROWS: list[tuple[str, list[str]]] = [
    ("RENI++", ["18.02", "20.87", "21.13", "22.10"]),
    ("SH", ["15.00", "17.88", "18.23", "19.15"]),
    ("spherical Gaussians", ["17.67", "19.27", "19.81", "20.24"]),
]
_RENI_COLUMNS = ["27 floats", "108 floats", "147 floats", "300 floats"]
_RENI = "RENI++ (Gardner et al.), tone-mapped PSNR in dB on 21 held-out outdoor maps, "
_SPHERES = [
    *(f"si-RMSE, {material}" for material in ("diffuse", "silver", "mirror")),
    *(f"colour, {material}, deg" for material in ("diffuse", "silver", "mirror")),
]
_LEVELS = ("whole_colour", "whole_level", "lower_colour", "lower_level", "log_radiance")
# Heading, columns, rows: what others measured on their own maps, by a protocol that the heading
# compares with ours.
PEERS: dict[str, tuple[str, list[str], list[tuple[str, list[str]]]]] = {
    "sky-representations": (
        f"{_RENI}over the whole sphere and at its own resolution, hence no competitor of the "
        "numbers above:",
        _RENI_COLUMNS,
        _RENI_ROWS,
    ),
    "light-representations": (
        f"{_RENI}over the whole sphere; SH and Gaussians above say how much harder or easier "
        "these maps are than theirs:",
        _RENI_COLUMNS,
        _RENI_ROWS,
    ),
    "any-light": (
        "Three spheres as published (Liang et al. 2025, LuxDiT, Table 1, means): from a view of a "
        "place where ours is from a face, other maps, and pictures of spheres by another renderer "
        "after another tone mapping, so a scale and no contest:",
        _SPHERES,
        [
            ("StyleLight, Laval Indoor", ["0.135", "0.315", "0.552", "4.238", "4.742", "6.781"]),
            (
                "DiffusionLight, Laval Indoor",
                ["0.124", "0.325", "0.597", "2.500", "3.421", "5.936"],
            ),
            ("LuxDiT, Laval Indoor", ["0.112", "0.297", "0.586", "2.555", "3.526", "5.641"]),
            ("StyleLight, Poly Haven", ["0.138", "0.336", "0.620", "3.034", "4.272", "6.602"]),
            ("NLFE, Poly Haven", ["0.159", "0.326", "0.571", "3.305", "4.240", "5.180"]),
            ("DiffusionLight, Poly Haven", ["0.113", "0.270", "0.519", "2.199", "3.121", "4.104"]),
            ("LuxDiT, Poly Haven", ["0.077", "0.196", "0.442", "1.235", "1.977", "2.783"]),
        ],
    ),
}


def summarise(items: Iterable[Item]) -> Rows:
    """Mean, median, standard deviation and count of each metric over the items that have it."""
    values: dict[str, dict[str, list[float]]] = {}
    for item in items:
        for method, metrics in item.metrics.items():
            for metric, value in metrics.items():
                values.setdefault(method, {}).setdefault(metric, []).append(value)
    return {
        method: {metric: _statistics(v) for metric, v in metrics.items()}
        for method, metrics in values.items()
    }


def summarise_groups(items: Iterable[Item]) -> dict[str, Rows]:
    """:func:`summarise` for every value of the facts in :data:`GROUPED_BY`, as "fact: value"."""
    groups: dict[str, list[Item]] = {}
    for item in items:
        for fact in GROUPED_BY:
            if fact in item.facts:
                groups.setdefault(f"{fact}: {item.facts[fact]}", []).append(item)
    return {name: summarise(members) for name, members in sorted(groups.items())}


def _statistics(values: list[float]) -> dict[str, float]:
    return {
        "mean": float(np.mean(values)),
        "median": float(np.median(values)),
        "std": float(np.std(values)),
        "n": len(values),
    }


def markdown(results: dict) -> str:
    """The tables of one evaluation's ``results.json``."""
    rows: Rows = results["rows"]
    methods = list(rows)
    metrics = [m for m in LABELS if any(m in rows[method] for method in methods)]
    others = {m for method in methods for m in rows[method]} - set(metrics)
    metrics += sorted(others, key=_by_number)
    missed = len(results["problems"])
    lines = [
        f"# {results['name']}",
        "",
        f"`{results['command']}`, {results['n']} items, commit {results['commit']}, "
        f"{results['date']}, {results['machine']}. Mean ± standard deviation, median in brackets."
        + (f" {missed} items with a problem (below)." if missed else ""),
        "",
        *_oriented(
            methods,
            [
                (LABELS.get(metric, metric), [_cell(rows[m].get(metric)) for m in methods])
                for metric in metrics
            ],
        ),
    ]
    name = results["name"].removesuffix("-real")
    if name in BESIDE:
        lines += _thesis(BESIDE[name])
    if name in PEERS:
        lines += ["", PEERS[name][0], "", *_table(*PEERS[name][1:])]
    for group, inside in results.get("groups", {}).items():
        lines += _group(group, inside)
    if results["checks"]:
        cells = [
            (name, [f"{c['value']:.4g}", c["goal"], "yes" if c["ok"] else "no"])
            for name, c in results["checks"].items()
        ]
        lines += ["", *_table(["value", "goal", "met"], cells)]
    lines += ["", *(f"- {name}: {why}" for name, why in results["problems"].items())]
    return "\n".join(lines).rstrip() + "\n"


def _thesis(table: ThesisTable) -> list[str]:
    by_metric = zip(*(row.split() for row in table.rows.values()), strict=True)
    cells = [
        (LABELS[metric].removesuffix(IN_CELLS), [cell.replace("±", " ± ") for cell in row])
        for metric, row in zip(METRICS, by_metric, strict=True)
    ]
    return ["", f"{table.title}:", "", *_table(list(table.rows), cells)]


def _by_number(metric: str) -> list[tuple[int, str]]:
    """l2_4 before l2_16."""
    return [(int(p) if p.isdigit() else 0, p) for p in re.split(r"(\d+)", metric)]


def _group(title: str, rows: Rows) -> list[str]:
    """A group's means and standard deviations, of the metrics that others quote; or nothing."""
    metrics = [
        m for m in (*METRICS, *_LEVELS, *_PEERS_METRICS) if any(m in r for r in rows.values())
    ]
    if not metrics:
        return []
    count = max(s["n"] for metrics_of in rows.values() for s in metrics_of.values())
    cells = [
        (
            LABELS[metric],
            [
                f"{r[metric]['mean']:.3g} ± {r[metric]['std']:.2g}" if metric in r else ""
                for r in rows.values()
            ],
        )
        for metric in metrics
    ]
    return ["", f"{title} ({count:.0f}):", "", *_oriented(list(rows), cells)]


def _oriented(columns: list[str], rows: list[tuple[str, list[str]]]) -> list[str]:
    """As given, or turned about where there are more columns than a page is wide."""
    if len(columns) <= _COLUMNS:
        return _table(columns, rows)
    turned = zip(*(cells for _, cells in rows), strict=True)
    named = [(name, list(cells)) for name, cells in zip(columns, turned, strict=True)]
    return _table([name for name, _ in rows], named)


def _table(columns: list[str], rows: list[tuple[str, list[str]]]) -> list[str]:
    head = ["| | " + " | ".join(columns) + " |", "|" + "---|" * (len(columns) + 1)]
    return head + ["| " + " | ".join([name, *cells]) + " |" for name, cells in rows]


def _cell(statistics: dict[str, float] | None) -> str:
    if statistics is None or math.isnan(statistics["mean"]):
        return ""
    return "{mean:.3g} ± {std:.2g} [{median:.3g}]".format(**statistics)


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
        figure = Figure(figsize=(8, 6), layout="constrained")
        axes = figure.subplots()
        for number, (method, curve) in enumerate(methods.items()):
            style = ("-", "--", ":")[number // 10 % 3]
            axes.plot(*zip(*curve, strict=True), style, marker="o", ms=3, label=method)
        axes.set_xscale("log")
        axes.set_xlabel("activations, coefficients or lobes")
        axes.set_ylabel(LABELS.get(metric, metric))
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize=7, ncols=2)
        path = out / f"{metric}.png"
        save_figure(path, figure)
        written.append(path)
    return written
