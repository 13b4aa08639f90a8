"""Chapters 3 and 4 of the thesis: the voxel probe and the partitions probe."""

from skylight.evaluation._voxel_probe import THESIS_L1
from skylight.probes.voxel._model import exposed_faces, star_probe
from skylight.probes.voxel._reconstruct import ranks
from tools.figures.compared import Compared, Figure, beside, falls, numbers
from tools.records import mean, results

# Table 3.2, in the order of THESIS_L1
_MAE, _SSIM = (0.088, 0.084, 0.083, 0.081), (0.954, 0.957, 0.956, 0.959)
# Table 4.1: MAE, RMSE, SSIM
TABLE_4_1 = {
    "unshadowed": (0.646, 0.614, 0.913),
    "sh9": (0.242, 0.202, 0.965),
    "sh25": (0.138, 0.126, 0.983),
    "6d": (0.546, 0.397, 0.954),
    "14d": (0.442, 0.323, 0.969),
    "38d": (0.210, 0.169, 0.983),
    "110d": (0.114, 0.100, 0.991),
    "6d_np": (1.991, 1.228, 0.921),
    "14d_np": (7.668, 4.662, 0.801),
    "38d_np": (24.701, 15.070, 0.580),
    "110d_np": (75.728, 46.271, 0.358),
    "6d_np_corr": (0.694, 0.478, 0.946),
    "14d_np_corr": (0.702, 0.477, 0.949),
    "38d_np_corr": (0.673, 0.458, 0.951),
    "110d_np_corr": (0.663, 0.451, 0.952),
}
_CHOSEN = (
    "the albedo of 0.8 and the cost of .16 a slot in Eq. 3.17, where the thesis has 1, were chosen "
    "by these numbers"
)
_REAL_TIME = 30  # frames a second
_OUR_RATE = f"the limit of {_REAL_TIME} frames/s is ours"


def voxel_probe() -> list[Figure]:
    evaluation, record = "`evaluate voxel-probe`", ("voxel-probe",)
    facts = results("voxel-probe")["items"]["transfer"]

    def of(metric: str) -> list[float]:
        return [mean("voxel-probe", kind, metric) for kind in THESIS_L1]

    maps = results("voxel-probe")["rows"]["probe3_direct"]["mae"]["n"]
    end_to_end = results("voxel-end-to-end")
    mask = exposed_faces(star_probe(3)).counts() > 0
    known = mask.sum(1)
    best = [one["residual"] for one in facts["best_sets"]]
    by_occluders = [float(left) for left in facts["by_occluders"].values()]
    drawn = "`python -m tools.draw_figures`, [picture](images/figures/transfer.png)"
    live = results("live")["voxel"]["frames_per_s"]
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
            cells=(falls(by_occluders),),
            uncounted="it cannot rise: each set holds the one before",
            where=evaluation,
            records=record,
        ),
        Figure(
            name="Fig. 3.7, 3.4.5",
            shows="best sets of 1 to 12 configurations; mean of all sets of five, the 3-probe's "
            "(squared residuals)",
            thesis="falls, as it must; 3.067, 2.693, ratio 0.878",
            ours=f"{numbers(best)}; {facts['sets_of_five']:.3f}, {facts['probe3_set']:.3f}, ratio "
            f"{facts['probe3_set'] / facts['sets_of_five']:.3f}",
            cells=(
                facts["sets_of_five"] <= 3.067,
                facts["probe3_set"] <= 2.693,
                facts["probe3_set"] / facts["sets_of_five"] <= 0.878,
            ),
            uncounted="squares and the albedo of 0.8 were chosen by these numbers",
            where=evaluation,
            records=record,
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
            cells=(bool((known == 5).all()),),
            where="`skylight probe voxel inspect --probe 3`",
        ),
        beside(
            "Fig. 3.9",
            "L1 error of transfer: 3-probe direct, global, 5-probe direct, global",
            tuple(THESIS_L1.values()),
            of("transfer_l1"),
            f"{evaluation}, {drawn.rpartition(', ')[2]}",
            records=record,
            digits=4,
            uncounted=_CHOSEN,
        ),
        _in_order("Fig. 3.9, order", of("transfer_l1"), digits=4, uncounted=_CHOSEN),
        beside("Table 3.2, MAE", f"relit models, order as in 3.9; {maps} maps", _MAE, of("mae"),
               evaluation, records=record),
        beside("Table 3.2, SSIM", "the same", _SSIM, of("ssim"), evaluation, records=record,
               more_is_better=True),
        _in_order("Table 3.2, order", of("mae"), [-value for value in of("ssim")]),
        Figure(
            name="Fig. 3.10",
            shows="parts of little volume",
            ours="thin-walled cubes",
            where="`skylight probe voxel print`, [parts](voxel_probe.md#parts)",
        ),
        Figure(
            name="Fig. 3.11",
            shows="fabricated and aligned (here: rendered from the printed parts)",
            ours=f"poses to {end_to_end['pose_error_mm_median']:.2f} mm and "
            f"{end_to_end['pose_error_deg_median']:.2f}° in the median",
            where="`python -m tools.measure_voxel_end_to_end`",
            records=("voxel-end-to-end",),
        ),
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
            ours=f"{live:.0f} frames/s of video on one core",
            cells=(live >= _REAL_TIME,),
            uncounted=_OUR_RATE,
            where="`python -m tools.measure_live`",
            records=("live",),
        ),
    ]  # fmt: skip


def _in_order(name: str, *errors: list[float], digits: int = 3, uncounted: str = "") -> Figure:
    """Whether errors, in the order of THESIS_L1, fall with the better probe and method (3.6.1)."""
    held = [pair for d3, g3, d5, g5 in errors for pair in (g3 < d3, g5 < d5, d5 < d3, g5 < g3)]
    return Figure(
        name=name,
        shows="what the thesis says of these numbers",
        thesis="global better than direct, and the 5-probe better than the 3-probe, in each pair",
        ours=" / ".join(numbers([abs(v) for v in row], digits) for row in errors),
        cells=tuple(held),
        uncounted=uncounted,
        where="`evaluate voxel-probe`",
        records=("voxel-probe",),
    )


def partitions_probe() -> list[Figure]:
    evaluation = "`evaluate partition-probe`"
    printed = "`python -m tools.draw_figures`, [picture](images/figures/partitions.png)"
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
            ours="solids of each named design",
            where="`skylight probe partitions print`",
        ),
        Figure(name="Fig. 4.3, 4.4", shows="cells, also outdoors", ours="drawn", where=printed),
        Figure(
            name="Fig. 4.5",
            shows="the interface",
            thesis="real time",
            ours=f"`skylight probe partitions live`: {live:.0f} frames/s of video on one core",
            cells=(live >= _REAL_TIME,),
            uncounted=_OUR_RATE,
            where="`python -m tools.measure_live`",
            records=("live",),
        ),
        Figure(
            name="Fig. 4.6",
            shows="acquisition with the 6D probe",
            ours=f"poses to {captured['pose_error_mm_median']:.2f} mm and "
            f"{captured['pose_error_deg_median']:.2f}°, samples to "
            f"{100 * captured['sample_error_median']:.1f} %, all in the median",
            where="`python -m tools.measure_partition_end_to_end`",
            records=("partition-end-to-end-6d",),
        ),
        *[_table_4_1(row) for row in TABLE_4_1],
        Figure(
            name="Fig. 4.7, 4.8, 4.9",
            shows="methods beside path tracing",
            ours="`pictures/` and `sheet.png` of the run, [one map](images/partition_designs.png)",
            where=evaluation,
        ),
    ]


def _table_4_1(row: str) -> Figure:
    names = ("mae_thesis", "rmse_thesis", "ssim")
    found = [mean("partition-probe", row, metric) for metric in names]
    rooms = results("partition-probe")["rows"][row]["ssim"]["n"]
    cells = {
        label: Compared(thesis=thesis, ours=ours, more_is_better=label == "SSIM").met
        for label, thesis, ours in zip(("MAE", "RMSE", "SSIM"), TABLE_4_1[row], found, strict=True)
    }
    worse = [label for label, met in cells.items() if not met]
    scale = "the scale of MAE and RMSE comes from the thesis' rows np"
    return Figure(
        name=f"Table 4.1, {row}",
        shows=f"MAE, RMSE, SSIM; {rooms} rooms (the thesis: 100)",
        thesis=numbers(TABLE_4_1[row], 3),
        ours=numbers(found, 3) + (f"; worse: {', '.join(worse)}" if worse else ""),
        cells=tuple(cells.values()),
        uncounted=scale if row.endswith("_np") else "",
        where="`evaluate partition-probe`",
        records=("partition-probe",),
    )
