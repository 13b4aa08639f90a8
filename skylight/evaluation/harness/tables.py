"""Results as Markdown tables, with the thesis' figures."""

import math
import re
from collections.abc import Iterable

import numpy as np

from skylight.evaluation.harness.run import Item
from skylight.evaluation.harness.thesis_figures import BESIDE, METRICS, ThesisTable

Rows = dict[str, dict[str, dict[str, float]]]  # method -> metric -> mean, median, std, n

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
    "sun_dw_mae": "Sun-dω MAE (l)",
    "sun_dw_mae_fixed": "Sun-dω MAE (l), at the true sun",
    "sun_angle_deg": "Sun-ang (l), deg",
    "main_lamp_deg": "angle to the main lamp, deg",
    "lamps_found": "lamps found, of those with a fifth of the light",
    "pose_deg": "pose error, deg",
    "in_region": "true sun in the 90 % region",
    "region_sr": "90 % region of the sun, sr",
    "psnr": "tone-mapped PSNR, dB",
    "tone_mapped_ssim": "tone-mapped SSIM",
    "floats": "floats",
    "floats_per_activation": "floats per activation, indices included",
    "l2": "relative L2 error",
    "srgb_rmse": "RMSE of sRGB values, person",
    "srgb_ssim": "SSIM, person",
    "srgb_rmse_skin": "RMSE of sRGB values, skin",
    "srgb_ssim_skin": "SSIM, skin",
    "seconds": "seconds",
    "cpu_seconds": "seconds of a core",
    "transport_seconds": "seconds of ray tracing",
    "peak_mib": "peak memory of the process so far, MiB",
}
_COLUMNS = 8
GROUPED_BY = (
    "category",
    "half",
    "regime",
    "skin tone",
    "verdict",
)  # facts of which each value gets its own rows
_PEERS_METRICS = ("psnr", "tone_mapped_ssim")
# Heading, columns, rows: what others measured by the same protocol, on their own maps.
PEERS: dict[str, tuple[str, list[str], list[tuple[str, list[str]]]]] = {
    "sky-representations": (
        "RENI++ (Gardner et al.), tone-mapped PSNR in dB on 21 held-out outdoor maps, over the "
        "whole sphere and at its own resolution, hence no competitor of the numbers above:",
        ["27 floats", "108 floats", "147 floats", "300 floats"],
        [
            ("RENI++", ["18.02", "20.87", "21.13", "22.10"]),
            ("SH", ["15.00", "17.88", "18.23", "19.15"]),
            ("spherical Gaussians", ["17.67", "19.27", "19.81", "20.24"]),
        ],
    )
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
    methods = list(table.means)
    cells = [
        (LABELS[k], [f"{table.mean(m, k):.2f} ± {table.std(m, k):.2f}" for m in methods])
        for k in METRICS
    ]
    return ["", f"{table.title}:", "", *_table(methods, cells)]


def _by_number(metric: str) -> list[tuple[int, str]]:
    """l2_4 before l2_16."""
    return [(int(p) if p.isdigit() else 0, p) for p in re.split(r"(\d+)", metric)]


def _group(title: str, rows: Rows) -> list[str]:
    """A group's means and standard deviations, of the metrics that others quote; or nothing."""
    metrics = [m for m in (*METRICS, *_PEERS_METRICS) if any(m in r for r in rows.values())]
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
