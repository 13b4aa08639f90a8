"""Pages that tools write: they say what the recorded results say."""

import json
import re
from pathlib import Path

import pytest

from tools import build_figures, build_measurements, records
from tools.figures import compared, light, probes
from tools.load import table

ROWS = {"a": 0.2, "b": 0.3, "c": 0.1}
MODELS = ("sh9", "sh25", "sunsky")
FED = "spline network, only fed, in the autoencoder's place"
SPLINE = "spline network in the autoencoder's place"
BY_SOLVER = "spline network by the thesis' solver (B.1) in the autoencoder's place"
RECIPE = "[trained by its recipe](model_card.md#the-thesis-recipe) on 496 skies"
# What the page must show, in this order: nothing drops out by itself
ROWS_3 = [
    "Fig. 3.1", "Fig. 3.2, 3.4", "Fig. 3.3, 3.5", "Fig. 3.6", "Fig. 3.7, 3.4.5", "Fig. 3.8",
    "Table 3.1", "Fig. 3.9", "Fig. 3.9, order", "Table 3.2, MAE", "Table 3.2, SSIM",
    "Table 3.2, order", "Fig. 3.10", "Fig. 3.11", "Fig. 3.12", "Fig. 3.13",
]  # fmt: skip
ROWS_4 = [
    "Fig. 4.1", "Fig. 4.2", "Fig. 4.3, 4.4", "Fig. 4.5", "Fig. 4.6",
    *(f"Table 4.1, {row}" for row in ("unshadowed", "sh9", "sh25", "6d", "14d", "38d", "110d")),
    *(f"Table 4.1, {n}d_np{corrected}" for corrected in ("", "_corr") for n in (6, 14, 38, 110)),
    "Fig. 4.7, 4.8, 4.9",
]  # fmt: skip
ROWS_5 = [
    "Fig. 5.1, B.1", "Fig. 5.2", "Fig. 5.3, B.2", "Fig. 5.4, B.3", "Fig. 5.5",
    *(f"Table 5.1, {row}" for row in (*MODELS, FED, SPLINE)),
    f"Table 5.1, the thesis' autoencoder, only fed, {RECIPE}",
    f"Table 5.1, the thesis' autoencoder, {RECIPE}",
    *(f"Table 5.1, {row}" for row in (*MODELS, FED, SPLINE)),
    "Fig. 5.6",
    *(f"Table 5.2, {row}" for row in (*MODELS, SPLINE, BY_SOLVER) * 2),
    "Fig. 5.7", "Table 5.3", "Fig. 5.8a, B.5", "Fig. 5.8b, B.6", "Fig. 5.8c, B.7", "Fig. B.4",
]  # fmt: skip
ROWS_6 = [
    "Fig. 6.1", "Fig. 6.2", "Fig. 6.3", "Fig. 6.4a", "Fig. 6.4b", "Fig. 6.5, 6.10, C.2 to C.12",
    "Fig. 6.6, C.1", "Fig. 6.7", "Fig. 6.8", "Fig. 6.8", "Fig. 6.9", "Fig. 6.9",
]  # fmt: skip


@pytest.fixture
def rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """``l2`` of three rows at 4 and at 9; at 9 c is no longer the least."""

    def results(_: str) -> dict:
        at_9 = ROWS | {"c": 0.25}
        found = {
            name: {"l2_4": {"mean": value}, "l2_9": {"mean": at_9[name]}, "l2_mean_4": {"mean": 9}}
            for name, value in ROWS.items()
        }
        return {"rows": found}

    monkeypatch.setattr(compared, "results", results)


@pytest.mark.parametrize(
    ("chapter", "expected"), list(enumerate([ROWS_3, ROWS_4, ROWS_5, ROWS_6])), ids=[*"3456"]
)
def test_no_row_is_left_out(chapter: int, expected: list[str]) -> None:
    assert [figure.name for figure in list(build_figures.chapters().values())[chapter]] == expected


def test_the_tables_are_those_of_the_results() -> None:
    """In a copy without the history all but the marks of age is compared."""
    page = build_figures.PAGE.read_text(encoding="utf-8")
    if records.has_history():
        assert build_figures.table() in page, "run python -m tools.build_figures"
    for mark in (records.OLDER, records.LOST):
        page = page.replace(f", {mark}", "")
    assert build_figures.table(mark=lambda _: "") in page, "run python -m tools.build_figures"


def test_marks_stand_in_every_row_of_their_record() -> None:
    text = build_figures.table(mark=lambda name: "LATE" if name == "lamps" else "")
    late = [line for line in text.splitlines() if "LATE" in line]
    assert [line.split(" | ")[0] for line in late] == ["| Table 5.3"]
    (mark,) = {records.commit_of(records.results("lamps"))}
    assert late[0].endswith(f"lamps at {mark}, LATE |")


def test_every_row_with_a_number_of_a_record_names_the_record() -> None:
    for figures in build_figures.chapters().values():
        for figure in figures:
            if figure.cells and figure.name != "Table 3.1":  # which counts a probe's faces
                assert figure.records, figure.name


CODE = r"(ani|iso|kmeans|vmf)"
BASES = "sh|sh_windowed|haar"


@pytest.mark.parametrize(
    ("record", "shown", "kind"),
    [
        ("sparse-coding", light.NNLS_40, rf"{CODE}_k40_nnls|sh|sh_windowed"),
        ("sparse-coding", light.BOTH_40, rf"{CODE}_k40_\w+|{BASES}"),
        ("sparse-coding", light.SHARPER, rf"(?!\w+_k40)\w+_(nnls|l1)|vmf_k40_\w+|sg|{BASES}"),
        ("sparse-inverse", light.FROM_OBJECT, r"\w+_(nnls|l1)|sh"),
        ("transport-compression", light.ROWS_OF_T, r"\w+"),
    ],
)
def test_plots_show_every_row_of_their_record(record: str, shown: dict, kind: str) -> None:
    measured = [name for name in records.results(record)["rows"] if "_outdoor" not in name]
    assert {name for name in measured if re.fullmatch(kind, name)} == set(shown) & set(measured)


def test_the_page_of_measurements_has_every_record(tmp_path: Path) -> None:
    page = tmp_path / "measurements.md"
    build_measurements.write(page)
    text, made = page.read_text(encoding="utf-8"), page.stat().st_mtime_ns
    build_measurements.write(page)
    assert page.stat().st_mtime_ns == made  # nothing is read anew where nothing has changed
    for path in build_measurements.RESULTS.glob("*.json"):
        content = json.loads(path.read_text(encoding="utf-8"))
        if "rows" in content or "what" in content:  # the others are benchmarks and a page of skies
            assert f"\n## {content['name']}\n" in text, path
    assert "\n## Benchmarks\n" in text


def test_the_table_of_the_studio_under_load_is_that_of_its_record() -> None:
    written = table.PAGE.read_text(encoding="utf-8")
    assert table.section(table.records()) in written, "run python -m tools.load.table"


@pytest.mark.parametrize(("ours", "met"), [(0.088, True), (0.0881, False), (0.05, True)])
def test_a_number_is_at_or_past_the_thesis(ours: float, met: bool) -> None:
    number = compared.Compared
    assert number(thesis=0.088, ours=ours).met == met
    assert number(thesis=-0.088, ours=-ours, more_is_better=True).met == met


def figure(*cells: bool, uncounted: str = "") -> compared.Figure:
    return compared.Figure(name="", shows="", ours="", where="", cells=cells, uncounted=uncounted)


def test_a_row_is_met_where_each_cell_is() -> None:
    assert [figure(*cells).met for cells in ((), (True,), (True, False))] == [None, True, False]
    assert [figure().verdict, figure(True).verdict, figure(True, False).verdict] == [
        "", "yes", "**no**"
    ]  # fmt: skip
    assert figure(True, uncounted="ours").verdict == "(yes: ours)"


def test_what_is_not_the_thesis_own_is_not_counted() -> None:
    told = build_figures.counted(
        [figure(True, True), figure(True, False, True), figure(True, uncounted="ours"), figure()]
    )
    assert "Of the 2 rows" in told
    assert ", 1 are met in every cell; of their 5 cells" in told
    assert "pairs of an ordering) 4." in told
    assert "1 of 1 are yes. The other 1 rows" in told


def sky_row(**changed: float) -> compared.Figure:
    """Sun and sky as good as in the thesis, but for what is changed."""
    cells = (0.54, 0.37, 0.23, 0.40, 0.18, 0.06, 0.68)
    names = [*compared.METRICS, "sun_dw_mae_fixed"]
    means = dict(zip(names, (*cells, 0.06), strict=True)) | changed
    values = {name: {"mean": value, "n": 3} for name, value in means.items()}
    return compared.thesis_row(
        "", light.TABLE_5_1, "sunsky", {"ours": values}, "ours", shows="", where="", record=""
    )


def test_both_readings_of_the_sun_must_be_past_the_one_number() -> None:
    assert sky_row().cells == (True,) * 7
    by_pixel = sky_row(sun_dw_mae_fixed=0.07)
    assert by_pixel.cells == (True,) * 5 + (False, True)
    assert by_pixel.ours == ".54 .37 .23 .40 .18 .06 (.07); 0.7°; worse: Sun by pixel"
    assert sky_row(sun_dw_mae=0.07).ours.endswith("worse: Sun")
    assert sky_row(mae=0.55).ours.endswith("worse: MAE")


def plot(*pairs: tuple[str, str], at: int = 4, rises: bool = False) -> compared.Figure:
    names = {name: name.upper() for name in "abcd"}
    told = compared.Statement(words="", pairs=pairs)
    return compared.stated("", "", "any", "l2", told, "", at=at, rows=names, rises=rises)


@pytest.mark.usefixtures("rows")
def test_a_statement_holds_at_every_count_and_all_rows_are_shown() -> None:
    assert plot(("a", "b")).met
    assert plot(("a", "b")).ours == "C 0.100, A 0.200, B 0.300"
    assert plot(("b", "a"), rises=True).met
    assert plot(("b", "a"), rises=True).ours == "B 0.300, A 0.200, C 0.100"
    assert plot(("b", "a")).ours.endswith("; against it: A before B")
    late = plot(("c", "a"), ("a", "b"))
    assert late.cells == (False, True)
    assert late.ours.endswith("; against it at other counts: 1 more pairs")
    assert plot(("c", "a"), at=9).ours.endswith("; against it: A before C")


@pytest.mark.usefixtures("rows")
def test_a_row_that_was_not_measured_is_named_and_not_met() -> None:
    missing = plot(("a", "b"), ("a", "d"))
    assert missing.cells == (True, False)
    assert missing.ours.endswith("; not measured: D")


def test_pairs_are_of_each_with_each_but_itself() -> None:
    assert compared.each_before("ab", "bc") == (("a", "b"), ("a", "c"), ("b", "c"))


def test_table_4_1_is_the_thesis_own() -> None:
    """Section 4.7: 15 methods; without walls errors grow with the cells."""
    without = [probes.TABLE_4_1[f"{n}d_np"] for n in (6, 14, 38, 110)]
    assert without == sorted(without)
    assert len(probes.TABLE_4_1) == 15
    assert probes.TABLE_4_1["110d_np"] == (75.728, 46.271, 0.358)


def test_a_fall_is_one_at_every_step() -> None:
    assert compared.falls([3.0, 2.0, 1.0])
    assert not compared.falls([3.0, 1.0, 1.0])


def named(start: str) -> list[compared.Figure]:
    every = [f for figures in build_figures.chapters().values() for f in figures]
    return [figure for figure in every if figure.name.startswith(start)]


@pytest.mark.parametrize(
    ("table_", "rows_of_the_thesis"),
    [("Table 4.1", 15 - 4), ("Table 5.1", 5), ("Table 5.2", 4), ("Fig. 6.8", 1), ("Fig. 6.9", 1)],
)
def test_each_row_of_the_thesis_counts_once(table_: str, rows_of_the_thesis: int) -> None:
    """Of Table 4.1 those without walls and correction give its scale, so they cannot count."""
    counted = [f.name for f in named(table_) if f.cells and not f.uncounted]
    assert len(counted) == len(set(counted)) == rows_of_the_thesis


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("Fig. 3.6", "it cannot rise"),
        ("Fig. 3.7, 3.4.5", "were chosen by these numbers"),
        ("Fig. 3.9", "were chosen by these numbers"),
        ("Fig. 3.9, order", "were chosen by these numbers"),
        ("Fig. 3.13", "is ours"),
        ("Fig. 4.5", "is ours"),
        ("Fig. 5.8a, B.5", "is ours"),
        ("Fig. 5.8b, B.6", "is ours"),
        ("Fig. 5.8c, B.7", "is ours"),
    ],
)
def test_limits_and_constants_of_ours_are_named_and_do_not_count(name: str, reason: str) -> None:
    (row,) = (figure for figure in named(name) if figure.name == name)
    assert reason in row.uncounted


def test_captured_maps_are_those_that_no_setting_was_chosen_by() -> None:
    held_out = records.results("sky-models-real")["groups"]["half: held-out"]
    row = next(f for f in named("Table 5.1, sunsky") if "captured" in f.shows)
    assert row.ours.startswith(compared.numbers([held_out["sunsky"]["mae"]["mean"]]))
    assert f"{held_out['sunsky']['mae']['n']} captured maps, held out" in row.shows


def test_table_5_3_says_what_its_number_is() -> None:
    (row,) = named("Table 5.3")
    assert row.met is None
    for words in ("not the same test", "in the median", "one lamp", "grey", "tinted", "settings"):
        assert words in row.ours


def test_ages_without_a_history_are_a_whole_paragraph(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(records, "has_history", lambda: False)
    assert build_measurements._ages({}).endswith("tells what changed since.\n")


def test_numbers_of_a_result_stand_under_their_names() -> None:
    found = {"photos": 3, "machine": {"cores": 2, "name": "x"}, "seconds": 1.23456, "each": [1]}
    assert build_measurements._numbers("run", found) == [
        ("run photos", "3"),
        ("run machine cores", "2"),
        ("run machine name", "x"),
        ("run seconds", "1.235"),
    ]
    assert build_measurements._numbers("run", {str(i): i for i in range(99)}) == []
