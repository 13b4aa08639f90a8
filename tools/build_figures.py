"""Write the table of the thesis' figures into ``docs/figures.md``, between its two marks.

    python -m tools.build_figures

Numbers are read from ``benchmarks/results``; the thesis' own are those that it prints in its tables
and captions (its plots have no numbers, so of those only orderings can be compared).
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from skylight.evaluation._tables import LABELS, METRICS, TABLE_5_1, TABLE_5_2, ThesisTable
from skylight.evaluation._voxel_probe import THESIS_L1
from skylight.io._atomic import atomic_path
from skylight.probes.voxel._model import exposed_faces, star_probe
from skylight.probes.voxel._reconstruct import ranks

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "figures.md"
BEGIN, END = "<!-- written by tools/build_figures.py: -->", "<!-- until here -->"
# Table 3.2, in the order of THESIS_L1
_MAE, _SSIM = (0.088, 0.084, 0.083, 0.081), (0.954, 0.957, 0.956, 0.959)


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One table or figure: the thesis' numbers and ours; ``met`` is None where none are printed."""

    name: str
    shows: str
    thesis: str = ""
    ours: str
    met: bool | None = None
    where: str  # the command or page that makes it


@dataclass(frozen=True, kw_only=True)
class Compared:
    """A number of the thesis beside ours, which counts unrounded."""

    thesis: float
    ours: float
    more_is_better: bool = False

    @property
    def met(self) -> bool:
        return self.ours >= self.thesis if self.more_is_better else self.ours <= self.thesis


def main() -> None:
    page = PAGE.read_text(encoding="utf-8")
    head, rest = page.split(BEGIN)
    _, tail = rest.split(END)
    with atomic_path(PAGE) as temporary:
        temporary.write_text(f"{head}{BEGIN}\n\n{table()}\n{END}{tail}", encoding="utf-8")
    print(PAGE)


def table() -> str:
    """All figures by chapter, and how many of those with numbers are at or past the thesis'."""
    chapters: dict[str, list[Figure]] = {
        "Chapter 3: the voxel probe": voxel_probe(),
        "Chapter 4: the partitions probe": partitions_probe(),
        "Chapter 5 and appendix B: faces to outdoor light": faces(),
        "Chapter 6 and appendix C: sparse codes": sparse_codes(),
    }
    every = [figure for figures in chapters.values() for figure in figures]
    told = [figure for figure in every if figure.met is not None]
    lines = [
        f"Of the {len(told)} rows that can be compared, {sum(bool(f.met) for f in told)} are at or "
        f"past the thesis' figure (orderings count where it plots no numbers); the other "
        f"{len(every) - len(told)} are pictures. Appendix A lists contributors.",
    ]
    for title, figures in chapters.items():
        lines += ["", f"### {title}", ""]
        lines += ["| | shows | thesis | skylight | met | from |", "|---|---|---|---|---|---|"]
        lines += [
            f"| {f.name} | {f.shows} | {f.thesis} | {f.ours} | {_met(f.met)} | {f.where} |"
            for f in figures
        ]
    return "\n".join(lines) + "\n"


def voxel_probe() -> list[Figure]:
    evaluation = "`evaluate voxel-probe`"
    facts = results("voxel-probe")["items"]["transfer"]

    def of(metric: str) -> list[float]:
        return [mean("voxel-probe", kind, metric) for kind in THESIS_L1]

    end_to_end = results("voxel-end-to-end")
    mask = exposed_faces(star_probe(3)).counts() > 0
    known = mask.sum(1)
    best = [one["residual"] for one in facts["best_sets"]]
    by_occluders = [float(left) for left in facts["by_occluders"].values()]
    drawn = "`python -m tools.draw_figures`, [picture](images/figures/transfer.png)"
    return [
        Figure(
            name="Fig. 3.1",
            shows="a printed probe and a model drawn in its light",
            ours="rendered captures, see 3.11",
            where="[voxel probe](voxel_probe.md)",
        ),
        Figure(
            name="Fig. 3.2, 3.4",
            shows="coarse occlusion, a face's frame",
            ours="explained",
            where="[concepts](concepts/voxel_probe.md)",
        ),
        Figure(name="Fig. 3.3, 3.5", shows="slots and their transfer", ours="drawn", where=drawn),
        Figure(
            name="Fig. 3.6",
            shows="squared residuals, all faces of up to n occluders known",
            thesis="falls with each set",
            ours=numbers(by_occluders),
            met=falls(by_occluders),
            where=evaluation,
        ),
        Figure(
            name="Fig. 3.7, 3.4.5",
            shows="best sets of 1 to 12 configurations; mean of all sets of five, the 3-probe's",
            thesis="falls; 3.067, 2.693, ratio 0.878",
            ours=f"{numbers(best)}; {facts['sets_of_five']:.3f}, {facts['probe3_set']:.3f}, ratio "
            f"{facts['probe3_set'] / facts['sets_of_five']:.3f}",
            met=falls(best) and facts["probe3_set"] <= 2.693,
            where=evaluation,
        ),
        Figure(
            name="Fig. 3.8",
            shows="star-shaped probes",
            ours="drawn",
            where="`python -m tools.draw_figures`, [picture](images/figures/star_probes.png)",
        ),
        Figure(
            name="Table 3.1",
            shows="configurations of the 3-probe",
            thesis="5 of each orientation",
            ours=f"{numbers(known.tolist(), 0)}, ranks {numbers(ranks(mask).tolist(), 0)}",
            met=bool((known == 5).all()),
            where="`skylight probe voxel inspect --probe 3`",
        ),
        beside(
            "Fig. 3.9",
            "L1 error of transfer: 3-probe direct, global, 5-probe direct, global",
            tuple(THESIS_L1.values()),
            of("transfer_l1"),
            f"{evaluation}, {drawn.rpartition(', ')[2]}",
            digits=4,
        ),
        Figure(
            name="Fig. 3.10",
            shows="parts of little volume",
            ours="63 % less material than solid cubes",
            where="`skylight probe voxel print`",
        ),
        Figure(
            name="Fig. 3.11",
            shows="fabricated and aligned (here: rendered from the printed parts)",
            ours=f"poses to {end_to_end['pose_error_mm_median']:.2f} mm and "
            f"{end_to_end['pose_error_deg_median']:.2f}°",
            where="`python -m tools.measure_voxel_end_to_end`",
        ),
        beside("Table 3.2, MAE", "relit models, order as in 3.9", _MAE, of("mae"), evaluation),
        beside("Table 3.2, SSIM", "the same", _SSIM, of("ssim"), evaluation, more_is_better=True),
        Figure(
            name="Fig. 3.12",
            shows="relit models beside path tracing",
            ours="`pictures/` and `sheet.png` of the run",
            where=evaluation,
        ),
        Figure(
            name="Fig. 3.13",
            shows="drawn in real time",
            thesis="real time in Unity",
            ours=f"{results('live')['voxel']['frames_per_s']:.0f} frames/s of video on one core",
            met=results("live")["voxel"]["frames_per_s"] >= 30,
            where="`python -m tools.measure_live`",
        ),
    ]


def partitions_probe() -> list[Figure]:
    evaluation = "`evaluate partition-probe`"
    printed = "`python -m tools.draw_figures`, [picture](images/figures/partitions.png)"
    thesis = {
        "unshadowed": (0.646, 0.614, 0.913),
        "sh9": (0.242, 0.202, 0.965),
        "sh25": (0.138, 0.126, 0.983),
        "6d": (0.546, 0.397, 0.954),
        "14d": (0.442, 0.323, 0.969),
        "38d": (0.210, 0.169, 0.983),
        "110d": (0.114, 0.100, 0.991),
        "6d_np_corr": (0.694, 0.478, 0.946),
    }
    rows = [
        beside(
            f"Table 4.1, {row}",
            "MAE, RMSE",
            errors,
            [mean("partition-probe", row, metric) for metric in ("mae_thesis", "rmse_thesis")],
            evaluation,
        )
        for row, (*errors, _) in thesis.items()
    ]
    rows.append(
        beside(
            "Table 4.1, SSIM",
            "all of these, in this order",
            [figures[-1] for figures in thesis.values()],
            [mean("partition-probe", row, "ssim") for row in thesis],
            evaluation,
            more_is_better=True,
        )
    )
    captured = results("partition-end-to-end-6d")
    live = results("live")["partitions"]["frames_per_s"]
    return [
        Figure(
            name="Fig. 4.1",
            shows="the probe at work",
            ours="rendered captures",
            where="[picture](images/partition_probe.png)",
        ),
        Figure(
            name="Fig. 4.2",
            shows="construction",
            ours="every named design prints",
            where="`skylight probe partitions print`",
        ),
        Figure(name="Fig. 4.3, 4.4", shows="cells, also outdoors", ours="drawn", where=printed),
        Figure(
            name="Fig. 4.5",
            shows="the interface",
            thesis="real time",
            ours=f"`skylight probe partitions live`: {live:.0f} frames/s of video on one core",
            met=live >= 30,
            where="`python -m tools.measure_live`",
        ),
        Figure(
            name="Fig. 4.6",
            shows="acquisition with the 6D probe",
            ours=f"poses to {captured['pose_error_mm_median']:.2f} mm and "
            f"{captured['pose_error_deg_median']:.2f}°, samples to "
            f"{100 * captured['sample_error_median']:.1f} %",
            where="`python -m tools.measure_partition_end_to_end`",
        ),
        *rows,
        Figure(
            name="Fig. 4.7, 4.8, 4.9",
            shows="methods beside path tracing",
            ours="`pictures/` and `sheet.png` of the run, [one map](images/partition_designs.png)",
            where=evaluation,
        ),
    ]


def faces() -> list[Figure]:
    models = ("sh9", "sh25", "sunsky", "autoencoder")
    sensitivity = "`evaluate face-sensitivity`"
    return [
        Figure(
            name="Fig. 5.1, B.1",
            shows="the fitted head over the photo",
            ours="in every report",
            where="`skylight estimate`, [pictures](estimate.md)",
        ),
        Figure(
            name="Fig. 5.2",
            shows="the autoencoder",
            ours="its layers and training",
            where="[model card](model_card.md)",
        ),
        Figure(
            name="Fig. 5.3, B.2",
            shows="rendered faces",
            thesis="135 faces",
            ours=f"{results('rendered-faces')['n']} faces",
            met=results("rendered-faces")["n"] >= 135,
            where="`skylight faces render`, [page](rendered_faces.md)",
        ),
        Figure(
            name="Fig. 5.4, B.3",
            shows="photographed faces and probes",
            thesis="131 photographs, not published",
            ours="tools to take one's own; faces under known lamps, below",
            where="[captures](face_captures.md)",
        ),
        Figure(
            name="Fig. 5.5",
            shows="models fitted to skies",
            ours="drawn",
            where="`evaluate sky-models`, [picture](images/sky_models.png)",
        ),
        *[_thesis_table("Table 5.1", TABLE_5_1, "sky-models", m) for m in TABLE_5_1.rows],
        *[
            _thesis_table("Table 5.1 on captured maps", TABLE_5_1, "sky-models-real", m)
            for m in TABLE_5_1.rows
        ],
        Figure(
            name="Fig. 5.6",
            shows="ten faces and their lights",
            ours="`figure_5_6.png` of the run",
            where="`evaluate synthetic-faces`",
        ),
        *[_thesis_table("Table 5.2", TABLE_5_2, "rendered-faces", m) for m in models],
        *[
            _thesis_table(
                "Table 5.2, skies of another model", TABLE_5_2, "rendered-faces-hosek-wilkie", m
            )
            for m in models
        ],
        Figure(
            name="Fig. 5.7",
            shows="photographs and their lights",
            ours=f"`sheet.png` of the run, {results('real-faces')['n']} photographs",
            where="`evaluate real-faces`",
        ),
        Figure(
            name="Table 5.3",
            shows="photographs with probes: angle to the main light, autoencoder",
            thesis="33.30° (131 outdoors)",
            ours=f"{mean('lamps', 'autoencoder', 'angle_deg'):.2f}° ({results('lamps')['n']} "
            "under one lamp: other photographs, so not the same test)",
            where="`evaluate lamps`",
        ),
        *_sensitivity(sensitivity),
        Figure(
            name="B.1",
            shows="the thesis' solver: angle of the sun, mean",
            thesis="23.55°",
            ours=f"{mean('rendered-faces', 'autoencoder_thesis', 'sun_angle_deg'):.2f}° (default "
            f"{mean('rendered-faces', 'autoencoder', 'sun_angle_deg'):.2f}°)",
            met=mean("rendered-faces", "autoencoder_thesis", "sun_angle_deg") <= 23.55,
            where="`evaluate synthetic-faces`",
        ),
        Figure(
            name="Fig. B.4",
            shows="albedos of nine grounds",
            ours="one's own from a chart on the ground",
            where="`skylight probe ground`",
        ),
    ]


def _sensitivity(command: str) -> list[Figure]:
    """Fig. 5.8: growth of the autoencoder's Full-dω MAE; the thesis says "stable"."""
    found = results("face-sensitivity")
    error = {
        row.removeprefix("autoencoder, "): values["full_dw_mae"]["mean"]
        for row, values in found["rows"].items()
        if row.startswith("autoencoder, ")
    }
    sizes = sorted(int(label.split()[1]) for label in error if label.startswith("size "))

    def grows(labels: list[str]) -> float:
        return sum(error[label] for label in labels) / len(labels) / error["unchanged"] - 1

    told = f"{found['n']} faces, {len({r.split(',')[0] for r in found['rows']})} models"
    parts = [
        ("a, B.5", f"{sizes[-1]} to {sizes[0]} pixels", "stable",
         error[f"size {sizes[0]}"] / error[f"size {sizes[-1]}"] - 1, 0.2),
        ("b, B.6", "pose off by 30°", "moderate penalty", grows(["yaw 30", "pitch 30"]), 0.5),
        ("c, B.7", "shape noise of 1.1", "stable", grows(["shape 1.1"]), 0.2),
    ]  # fmt: skip
    return [
        Figure(
            name=f"Fig. 5.8{name}",
            shows=f"{what}, {told}",
            thesis=f"{thesis} (taken as {100 * most:.0f} % at most)",
            ours=f"Full-dω MAE {100 * growth:+.0f} % (autoencoder)",
            met=growth <= most,
            where=command,
        )
        for name, what, thesis, growth, most in parts
    ]


def sparse_codes() -> list[Figure]:
    coding, inverse = "`evaluate sparse-coding`", "`evaluate sparse-inverse`"
    filters = "`python -m tools.draw_figures`, [picture](images/figures/filters.png)"
    compression = "`evaluate transport-compression`"
    n = results("sparse-coding")["n"]
    rooms = results("sparse-coding")["rows"]["sh"]["l2_64"]["n"]
    return [
        Figure(name="Fig. 6.1", shows="a filter over the sphere", ours="drawn", where=filters),
        Figure(
            name="Fig. 6.2",
            shows="harmonics",
            ours="drawn",
            where="[conventions](conventions.md)",
        ),
        Figure(name="Fig. 6.3", shows="filters", ours="drawn", where=filters),
        ordered("Fig. 6.4a", "L2 error at 64, 40 bands", "sparse-coding", "l2_64",
                ("ani_k40_nnls", "iso_k40_nnls", "vmf_k40_nnls", "sh_windowed"), coding),
        ordered("Fig. 6.4b", "error of light from a dragon, at 64", "sparse-inverse", "l2_64",
                ("ani_nnls", "vmf_nnls", "sh"), inverse),
        Figure(
            name="Fig. 6.5, 6.10, C.2 to C.12",
            shows="maps and their codes",
            ours=f"`pictures/` of the run, {n} maps; "
            "[a market hall](images/sparse_coding_market.png)",
            where=coding,
        ),
        Figure(
            name="Fig. 6.6, C.1",
            shows="light found from a dragon",
            ours="`pictures/` of the run",
            where=inverse,
        ),
        ordered("Fig. 6.7", "error of 1,000 transport rows, at 25", "transport-compression",
                "l2_25", ("ani_l1", "sh", "haar"), compression, last=("sh", "haar")),
        ordered("Fig. 6.8", f"L2 error at 100, {rooms} rooms, 40 bands", "sparse-coding", "l2_100",
                ("ani_k40_l1", "kmeans_k40_l1", "iso_k40_l1", "haar", "sh"), coding),
        ordered("Fig. 6.8", "the same with sharper filters", "sparse-coding", "l2_100",
                ("ani_l1", "kmeans_l1", "iso_l1", "haar", "sh"), coding),
        ordered("Fig. 6.9", "SSIM at 100, 40 bands", "sparse-coding", "ssim_100",
                ("ani_k40_nnls", "ani_k40_l1"), coding, rises=True),
        ordered("Fig. 6.9", "the same, and harmonics", "sparse-coding", "ssim_100",
                ("ani_k40_nnls", "sh"), coding, rises=True),
    ]  # fmt: skip


def beside(
    name: str,
    shows: str,
    thesis: Sequence[float],
    ours: Sequence[float],
    where: str,
    *,
    digits: int = 3,
    more_is_better: bool = False,
) -> Figure:
    """Numbers beside the thesis', met where each one is."""
    pairs = zip(thesis, ours, strict=True)
    return Figure(
        name=name,
        shows=shows,
        thesis=numbers(thesis, digits),
        ours=numbers(ours, digits),
        met=all(Compared(thesis=t, ours=o, more_is_better=more_is_better).met for t, o in pairs),
        where=where,
    )


def ordered(
    name: str,
    shows: str,
    of: str,
    metric: str,
    rows: tuple[str, ...],
    where: str,
    *,
    rises: bool = False,
    last: tuple[str, ...] = (),
) -> Figure:
    """The thesis' ordering, best first; rows of ``last`` are not ordered among themselves."""
    values = [mean(of, row, metric) for row in rows]
    signs = [-1 if rises else 1] * len(values)
    keys = [s * v for s, v in zip(signs, values, strict=True)]
    if last:
        first = keys[: len(keys) - len(last)]
        met = first == sorted(first) and first[-1] <= min(keys[len(first) :])
    else:
        met = keys == sorted(keys)
    shown = ", ".join(f"{row} {value:.3f}" for row, value in zip(rows, values, strict=True))
    order = f" {'>' if rises else '<'} ".join(rows[: len(rows) - len(last)])
    if last:
        order += " < the others"
    return Figure(name=name, shows=shows, thesis=order, ours=shown, met=met, where=where)


def _thesis_table(name: str, thesis: ThesisTable, of: str, method: str) -> Figure:
    compared = {
        metric: Compared(thesis=thesis.cell(method, metric)[0], ours=mean(of, method, metric))
        for metric in METRICS
    }
    worse = [LABELS[metric] for metric, c in compared.items() if not c.met]
    return Figure(
        name=f"{name}, {method}",
        shows="MAE, RMSE, si-RMSE, Full, Sky, Sun; angle",
        thesis=_seven([c.thesis for c in compared.values()]),
        ours=_seven([c.ours for c in compared.values()])
        + (f"; worse: {', '.join(worse)}" if worse else ""),
        met=not worse,
        where=f"`{results(of)['command'].removeprefix('skylight ')}`",
    )


def _seven(values: list[float]) -> str:
    return f"{numbers(values[:-1])}; {values[-1]:.1f}°"


def falls(values: list[float]) -> bool:
    return all(later < earlier for earlier, later in pairwise(values))


def numbers(values: Iterable[float], digits: int = 2) -> str:
    return " ".join(f"{float(value):.{digits}f}".lstrip("0") for value in values)


def _met(met: bool | None) -> str:
    return "" if met is None else "yes" if met else "**no**"


@cache
def results(name: str) -> dict[str, Any]:
    path = ROOT / "benchmarks" / "results" / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8"))


def mean(of: str, row: str, metric: str) -> float:
    return results(of)["rows"][row][metric]["mean"]


if __name__ == "__main__":
    main()
