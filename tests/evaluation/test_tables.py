"""Tables, and what an evaluation sets itself for goals."""

import re

import pytest

from skylight.evaluation._run import Item
from skylight.evaluation._sky_models import REAL_GOALS, SIMULATED_GOALS, SkyModels
from skylight.evaluation._tables import (
    _table,
    curves_of,
    markdown,
    summarise,
    summarise_groups,
    write_curves,
)

METHODS = ("sh9", "sh25", "sunsky", "autoencoder_feedforward", "autoencoder")


def items() -> list[Item]:
    """Method number m on sky number s has an error of m + s."""
    kinds = [("outdoor-sun", "development"), ("outdoor-sun", "held-out"), ("outdoor-nosun", "x")]
    return [
        Item(
            name=str(s),
            metrics={name: {"mae": float(m + s)} for m, name in enumerate(METHODS)},
            facts={"category": category, "half": half},
        )
        for s, (category, half) in enumerate(kinds)
    ]


def results(name: str, measured: list[Item]) -> dict:
    return {
        "name": name,
        "command": "c",
        "n": len(measured),
        "commit": "0",
        "date": "d",
        "machine": "m",
        "rows": summarise(measured),
        "groups": summarise_groups(measured),
        "checks": {},
        "problems": {},
    }


def test_every_value_of_a_grouping_fact_has_its_rows():
    groups = summarise_groups(items())
    assert list(groups) == [
        "category: outdoor-nosun",
        "category: outdoor-sun",
        "half: development",
        "half: held-out",
        "half: x",
    ]
    assert groups["category: outdoor-sun"]["sh25"]["mae"] == {
        "mean": 1.5,
        "median": 1.5,
        "std": 0.5,
        "n": 2,
    }


def test_every_word_of_direction_has_its_rows():
    words = ("sure", "rough", "sure")
    measured = [
        Item(name=str(i), metrics={"autoencoder": {"mae": float(i)}}, facts={"direction": word})
        for i, word in enumerate(words)
    ]
    groups = summarise_groups(measured)
    assert list(groups) == ["direction: rough", "direction: sure"]
    assert groups["direction: sure"]["autoencoder"]["mae"]["mean"] == 1.0  # of 0 and 2


def tables(page: str) -> list[dict[str, dict[str, float]]]:
    """Of each table of a Markdown page: the first number of each cell, by row and column."""
    found = []
    for block in re.findall(r"(?:^\|.*\n?)+", page, re.MULTILINE):
        head, _, *body = (
            [cell.strip() for cell in line.split("|")[1:-1]] for line in block.splitlines()
        )
        found.append(
            {
                row[0]: {h: float(c.split()[0]) for h, c in zip(head[1:], row[1:], strict=True)}
                for row in body
            }
        )
    return found


def test_a_page_begins_with_its_title_and_what_made_it():
    first, blank, second, end, table, *_ = markdown(results("sky-models-real", items())).split("\n")
    assert (first, blank, second[0], end, table[0]) == ("# sky-models-real", "", "`", "", "|")


def test_real_skies_stand_beside_the_thesis_too():
    ours, thesis, *groups = tables(markdown(results("sky-models-real", items())))
    assert ours["MAE (s)"] == {name: m + 1 for m, name in enumerate(METHODS)}
    assert thesis["MAE (s)"]["sunsky"] == 0.54  # Table 5.1
    assert thesis["Sun-ang (l), deg"]["autoencoder"] == 6.52
    (sunny,) = (g for g in groups if g["MAE (s)"]["sh9"] == 0.5)  # sky 0 and sky 1
    assert sunny["MAE (s)"] == {name: m + 0.5 for m, name in enumerate(METHODS)}


def test_many_methods_become_rows():
    wide = [Item(name="0", metrics={f"m{i}": {"psnr": float(i)} for i in range(12)})]
    ours, published = tables(markdown(results("sky-representations", wide)))
    assert [value for row in ours.values() for value in row.values()] == list(range(12))
    assert list(ours) == [f"m{i}" for i in range(12)]
    # Gardner et al., 2023
    assert list(published["RENI++"].values()) == [18.02, 20.87, 21.13, 22.10]


def rows(autoencoder: float, others: float) -> dict[str, dict[str, dict[str, float]]]:
    values = {m: (autoencoder if m == "autoencoder" else others) for m in METHODS}
    return {m: {k: {"mean": v} for k in SIMULATED_GOALS} for m, v in values.items()}


def test_simulated_goals_are_limits():
    checks = SkyModels(count=1).checks(rows(0.05, 1.0), [])
    assert all(checks[f"autoencoder {metric}"].ok for metric in SIMULATED_GOALS)
    assert not checks["autoencoder_feedforward mae"].ok  # 1.0, and 0.5 is the goal
    missed = SkyModels(count=1).checks(rows(0.8, 1.0), [])
    assert not any(missed[f"autoencoder {metric}"].ok for metric in SIMULATED_GOALS)


def test_real_goals_are_the_other_columns(tmp_path):
    (tmp_path / "index.csv").write_text("file,category\na.exr,outdoor-sun\n")
    evaluation = SkyModels(count=1, data=tmp_path)
    assert evaluation.name == "sky-models-real"
    checks = evaluation.checks(rows(0.5, 1.0), [])
    assert all(check.ok for check in checks.values())
    assert len(checks) == len(REAL_GOALS) + 1  # and the sun's angle
    values = rows(0.5, 1.0)
    values["sunsky"]["mae"]["mean"] = 0.4
    values["sunsky"]["sky_dw_mae"]["mean"] = 0.4  # of the sky only SH25 counts
    missed = [name for name, c in evaluation.checks(values, []).items() if not c.ok]
    assert [name.split()[1] for name in missed] == ["mae"]
    assert "(sunsky)" in evaluation.checks(values, [])[missed[0]].goal
    values["autoencoder"]["sun_angle_deg"]["mean"] = 3.5
    assert not evaluation.checks(values, [])["autoencoder sun_angle_deg"].ok


def test_without_a_fitted_autoencoder_there_is_nothing_to_check():
    assert SkyModels(count=1).checks({"sh9": {"mae": {"mean": 1.0}}}, []) == {}


def test_a_run_without_any_sun_is_checked_for_the_rest():
    values = rows(0.05, 1.0)
    for metrics in values.values():
        for metric in ("sun_dw_mae", "sun_angle_deg"):
            del metrics[metric]
    checks = SkyModels(count=1).checks(values, [])
    assert not any("sun_" in name for name in checks)
    assert checks["autoencoder mae"].value == pytest.approx(0.05)


def test_curves_are_of_metrics_at_two_counts_or_more(tmp_path):
    counted = {
        "ani": {"l2_16": 0.5, "l2_4": 0.9, "ssim_4": 0.3, "floats": 4.0},
        "sh": {"l2_4": 1.0},
    }
    found = summarise([Item(name="0", metrics=counted)])
    assert curves_of(found) == {"l2": {"ani": [(4, 0.9), (16, 0.5)]}, "ssim": {}}
    assert write_curves(tmp_path, found) == [tmp_path / "l2.png"]
    assert (tmp_path / "l2.png").read_bytes()[:4] == b"\x89PNG"


def test_groups_without_quoted_metrics_are_left_out():
    methods = {f"m{i}": {"l2_4": 0.1 * i} for i in range(10)}
    items = [Item(name="a", metrics=methods, facts={"category": "indoor"})]
    (only,) = tables(markdown(results("sparse-coding", items)))
    assert {name: row.popitem()[1] for name, row in only.items()} == pytest.approx(
        {name: metrics["l2_4"] for name, metrics in methods.items()}
    )


def test_a_table_has_a_column_for_names_and_one_for_each_other() -> None:
    assert _table(["a", "b"], [("x", ["1", "2"])]) == [
        "| | a | b |",
        "|---|---|---|",
        "| x | 1 | 2 |",
    ]
