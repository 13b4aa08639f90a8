"""Chapters 5 and 6 of the thesis: light from faces, and sparse codes."""

from skylight.evaluation._run import Rows
from skylight.evaluation._tables import TABLE_5_1, TABLE_5_2
from tools.figures.compared import Figure, Statement, each_before, stated, thesis_row
from tools.records import results

SPLINE = "spline network"
# What a row of the thesis is called where another network stands in its place
_NAMES = {
    "autoencoder_feedforward": f"{SPLINE}, only fed, in the autoencoder's place",
    "autoencoder": f"{SPLINE} in the autoencoder's place",
}
_OWN = {
    "autoencoder_feedforward": "the thesis' autoencoder, only fed",
    "autoencoder": "the thesis' autoencoder",
}
_OTHER_NETWORK = "another network than the thesis'"


def faces() -> list[Figure]:
    lamps = results("lamps")["rows"]["autoencoder"]["angle_deg"]
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
            where="`skylight faces render`, [page](rendered_faces.md)",
            records=("rendered-faces",),
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
        *sky_fits(),
        Figure(
            name="Fig. 5.6",
            shows="ten faces and their lights",
            ours="`figure_5_6.png` of the run",
            where="`evaluate synthetic-faces`",
        ),
        *rendered_faces(),
        Figure(
            name="Fig. 5.7",
            shows="photographs and their lights",
            ours=f"`sheet.png` of the run, {results('real-faces')['n']} photographs",
            where="`evaluate real-faces`",
            records=("real-faces",),
        ),
        Figure(
            name="Table 5.3",
            shows=f"photographs with probes: angle to the main light, {SPLINE}",
            thesis="33.30° (131 outdoors)",
            ours=f"not the same test: {lamps['mean']:.2f}° in the mean and {lamps['median']:.2f}° "
            f"in the median over {lamps['n']:.0f} indoor photographs under one lamp, grey, tinted "
            "as skin by us, some of which were looked at when settings were chosen",
            where="`evaluate lamps`",
            records=("lamps",),
        ),
        *sensitivity(),
        Figure(
            name="Fig. B.4",
            shows="albedos of nine grounds",
            ours="one's own from a chart on the ground",
            where="`skylight probe ground`",
        ),
    ]


def sky_fits() -> list[Figure]:
    """Table 5.1, each row of the thesis counted once: by captured maps and by its own network.

    Of the captured maps those that no setting was chosen by.
    """
    captured, simulated = results("sky-models-real"), results("sky-models")["rows"]
    held_out = captured["groups"]["half: held-out"]
    own = results("sky-models-thesis-recipe")["rows"]
    trained = "[trained by its recipe](model_card.md#the-thesis-recipe) on 496 skies"
    return [
        *[
            _of_table_5_1(row, held_out, "sky-models-real", "captured maps, held out",
                          uncounted=_OTHER_NETWORK if row in _NAMES else "")
            for row in TABLE_5_1.rows
        ],
        *[
            _of_table_5_1(row, own, "sky-models-thesis-recipe", "simulated skies",
                          name=f"{name}, {trained}")
            for row, name in _OWN.items()
        ],
        *[
            _of_table_5_1(row, simulated, "sky-models", "simulated skies",
                          uncounted="simulated skies, not captured ones")
            for row in TABLE_5_1.rows
        ],
    ]  # fmt: skip


def _of_table_5_1(
    row: str, ours: Rows, record: str, shows: str, *, name: str = "", uncounted: str = ""
) -> Figure:
    return thesis_row(
        f"Table 5.1, {name or _NAMES.get(row, row)}",
        TABLE_5_1,
        row,
        ours,
        row,
        shows=shows,
        where=_command(record),
        record=record,
        uncounted=uncounted,
    )


def _command(record: str) -> str:
    return f"`{results(record)['command'].removeprefix('skylight ')}`"


def rendered_faces() -> list[Figure]:
    """Table 5.2, each row of the thesis counted once: its autoencoder by its own solver (B.1)."""
    solver = f"{SPLINE} by the thesis' solver (B.1) in the autoencoder's place"
    ours = {row: (row, _NAMES.get(row, row), "") for row in TABLE_5_2.rows}
    ours["autoencoder"] = (*ours["autoencoder"][:2], "another network and solver")
    by_solver = ("autoencoder", solver, "")
    sets = (
        ("rendered-faces", "faces under simulated skies", ""),
        ("rendered-faces-hosek-wilkie", "faces under skies of another model",
         "the same rows under other skies"),
    )  # fmt: skip
    return [
        thesis_row(
            f"Table 5.2, {name}",
            TABLE_5_2,
            method,
            results(record)["rows"],
            row,
            shows=skies,
            where=_command(record),
            record=record,
            uncounted=other or uncounted,
        )
        for record, skies, other in sets
        for row, (method, name, uncounted) in {**ours, "autoencoder_thesis": by_solver}.items()
    ]


_STABLE, _MODERATE = 0.2, 0.5  # growths that we take those words for


def sensitivity() -> list[Figure]:
    """Fig. 5.8: growth of each model's Full-dω MAE; the thesis plots it and says "stable"."""
    found = results("face-sensitivity")
    every = {row: values["full_dw_mae"]["mean"] for row, values in found["rows"].items()}
    models = list(dict.fromkeys(row.partition(", ")[0] for row in every))
    sizes = sorted({int(row.split()[-1]) for row in every if ", size " in row})

    def grown(model: str, labels: list[str], start: str) -> float:
        error = sum(every[f"{model}, {label}"] for label in labels) / len(labels)
        return error / every[f"{model}, {start}"] - 1

    but_one = [model for model in models if model != "sunsky"]
    steady = "all but sunsky fairly stable"
    parts = [
        ("a, B.5", f"{sizes[-1]} to {sizes[0]} pixels (the thesis: photographs)",
         "all relatively stable, sunsky gains by size",
         [f"size {sizes[0]}"], f"size {sizes[-1]}", models, _STABLE),
        ("b, B.6", "pose off by 30°", "a moderate penalty for all but sunsky",
         ["yaw 30", "pitch 30"], "unchanged", but_one, _MODERATE),
        ("c, B.7", "shape noise of 1.1", steady, ["shape 1.1"], "unchanged", but_one, _STABLE),
    ]  # fmt: skip
    rows = []
    for name, what, words, labels, start, told, most in parts:
        growth = {model: grown(model, labels, start) for model in models}
        shown = {SPLINE if m == "autoencoder" else m: g for m, g in growth.items()}
        rows.append(
            Figure(
                name=f"Fig. 5.8{name}",
                shows=f"{what}; growth of the mean Full-dω MAE over {found['n']} rendered faces",
                thesis=words,
                ours=", ".join(f"{model} {round(100 * g):+d} %" for model, g in shown.items()),
                cells=tuple(growth[model] <= most for model in told),
                uncounted=f"the limit of {100 * most:.0f} % is ours",
                where="`evaluate face-sensitivity`",
                records=("face-sensitivity",),
            )
        )
    return rows


CODERS = ("ani", "iso", "kmeans", "vmf")
_BASES = {"sh": "sh", "sh_windowed": "sh windowed", "haar": "haar"}
# Rows of each plot: name in the record, name shown
NNLS_40 = {f"{d}_k40_nnls": d for d in CODERS} | {k: _BASES[k] for k in ("sh", "sh_windowed")}
BOTH_40 = {f"{d}_k40_{s}": f"{d} {s}" for d in CODERS for s in ("nnls", "l1")} | _BASES
SHARPER = (
    {f"{d}_{s}": f"{d} {s}" for d in ("ani", "iso", "kmeans", "box") for s in ("nnls", "l1")}
    | {f"vmf_k40_{s}": f"vmf {s}" for s in ("nnls", "l1")}
    | {"sg": "free Gaussians"}
    | _BASES
)
FROM_OBJECT = {f"{d}_nnls": d for d in CODERS} | {"ani_l1": "ani l1", "sh": "sh"}
ROWS_OF_T = {f"{d}_l1": d for d in CODERS} | {"ani_nnls": "ani nnls (every tenth row)"} | _BASES


def _l2_of(suffix: str, vmf: str) -> Statement:
    """What is said of Fig. 6.8, of codes whose weights have either sign."""
    ani, kmeans, iso = (f"{d}{suffix}_l1" for d in ("ani", "kmeans", "iso"))
    return Statement(
        words="of the l1 codes ani before kmeans before iso before vmf, and those three before "
        "haar; haar before sh",
        pairs=(
            *each_before([ani], [kmeans]),
            *each_before([kmeans], [iso]),
            *each_before([ani, kmeans, iso], [vmf, "haar"]),
            ("haar", "sh"),
        ),
    )


def _ssim_of(suffix: str) -> Statement:
    """What is said of Fig. 6.9."""
    positive = [f"{d}{suffix}_nnls" for d in ("ani", "iso", "kmeans")]
    signed = [f"{d}{suffix}_l1" for d in ("ani", "iso", "kmeans")]
    baselines = ["sh", "vmf_k40_nnls", "vmf_k40_l1"]
    return Statement(
        words="nnls of ani, iso and kmeans before all else; haar before the other baselines",
        pairs=(
            *each_before(positive, [*signed, *baselines, "haar", "sh_windowed"]),
            *each_before(["haar"], baselines),
        ),
    )


def sparse_codes() -> list[Figure]:
    coding, inverse = "`evaluate sparse-coding`", "`evaluate sparse-inverse`"
    filters = "`python -m tools.draw_figures`, [picture](images/figures/filters.png)"
    compression = "`evaluate transport-compression`"
    n = results("sparse-coding")["n"]
    rooms = results("sparse-coding")["rows"]["sh"]["l2_64"]["n"]
    lit = results("sparse-inverse")["rows"]["sh"]["l2_64"]["n"]
    ours = [f"{d}_k40_nnls" for d in ("ani", "iso", "kmeans")]
    direct = Statement(
        words="all codes before sh windowed; ani, iso, kmeans before vmf; ani before kmeans",
        pairs=(
            *each_before([*ours, "vmf_k40_nnls"], ["sh_windowed"]),
            *each_before(ours, ["vmf_k40_nnls"]),
            ("ani_k40_nnls", "kmeans_k40_nnls"),
        ),
    )
    codes = [f"{d}_nnls" for d in CODERS]
    from_object = Statement(
        words="all codes before sh; ani before all",
        pairs=(*each_before(codes, ["sh"]), *each_before(["ani_nnls"], codes)),
    )
    of_rows = Statement(
        words="all codes before sh", pairs=each_before([f"{d}_l1" for d in CODERS], ["sh"])
    )
    more = "filters sharper than the thesis'"
    maps = f"{rooms} rooms (the thesis: 32 maps), 40 bands"
    return [
        Figure(name="Fig. 6.1", shows="a filter over the sphere", ours="drawn", where=filters),
        Figure(
            name="Fig. 6.2",
            shows="harmonics",
            ours="drawn",
            where="[conventions](conventions.md)",
        ),
        Figure(name="Fig. 6.3", shows="filters", ours="drawn", where=filters),
        stated("Fig. 6.4a", f"L2 error, {rooms} rooms, 40 bands, nnls", "sparse-coding", "l2",
               direct, coding, at=64, rows=NNLS_40),
        stated("Fig. 6.4b", f"L2 error of light from a dragon, {lit} rooms, nnls",
               "sparse-inverse", "l2", from_object, inverse, at=64, rows=FROM_OBJECT),
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
        stated("Fig. 6.7", "L2 error of 1,000 transport rows (the thesis: 1,477), 24 bands, l1",
               "transport-compression", "l2", of_rows, compression, at=25, rows=ROWS_OF_T),
        stated("Fig. 6.8", f"L2 error, {maps}", "sparse-coding", "l2", _l2_of("_k40", "vmf_k40_l1"),
               coding, at=100, rows=BOTH_40),
        stated("Fig. 6.8", "the same with sharper filters", "sparse-coding", "l2",
               _l2_of("", "vmf_k40_l1"), coding, at=100, rows=SHARPER, uncounted=more),
        stated("Fig. 6.9", f"SSIM, {maps}", "sparse-coding", "ssim", _ssim_of("_k40"), coding,
               at=100, rows=BOTH_40, rises=True),
        stated("Fig. 6.9", "the same with sharper filters", "sparse-coding", "ssim", _ssim_of(""),
               coding, at=100, rows=SHARPER, rises=True, uncounted=more),
    ]  # fmt: skip
