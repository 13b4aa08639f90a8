"""Pages that tools write: they say what the recorded results say."""

import json
from pathlib import Path

import pytest

from tools import build_figures, build_measurements
from tools.load import table

ROWS = {"a": 0.2, "b": 0.3, "c": 0.1}


@pytest.fixture
def rows(monkeypatch: pytest.MonkeyPatch) -> None:
    def results(_: str) -> dict:
        return {"rows": {name: {"l2": {"mean": value}} for name, value in ROWS.items()}}

    monkeypatch.setattr(build_figures, "results", results)


def test_the_tables_are_those_of_the_results() -> None:
    page = build_figures.PAGE.read_text(encoding="utf-8")
    assert build_figures.table() in page, "run python -m tools.build_figures"


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
    compared = build_figures.Compared
    assert compared(thesis=0.088, ours=ours).met == met
    assert compared(thesis=-0.088, ours=-ours, more_is_better=True).met == met


@pytest.mark.usefixtures("rows")
def test_orderings_are_compared_best_first() -> None:
    def met(*order: str, rises: bool = False, last: tuple[str, ...] = ()) -> bool | None:
        return build_figures.ordered("Fig.", "", "any", "l2", order, "", rises=rises, last=last).met

    assert met("c", "a", "b")
    assert not met("a", "c", "b")
    assert met("b", "a", "c", rises=True)
    assert met("c", "b", "a", last=("b", "a"))
    assert not met("a", "b", "c", last=("b", "c"))


def test_a_fall_is_one_at_every_step() -> None:
    assert build_figures.falls([3.0, 2.0, 1.0])
    assert not build_figures.falls([3.0, 1.0, 1.0])


def test_numbers_of_a_result_stand_under_their_names() -> None:
    found = {"photos": 3, "machine": {"cores": 2, "name": "x"}, "seconds": 1.23456, "each": [1]}
    assert build_measurements._numbers("run", found) == [
        ("run photos", "3"),
        ("run machine cores", "2"),
        ("run machine name", "x"),
        ("run seconds", "1.235"),
    ]
    assert build_measurements._numbers("run", {str(i): i for i in range(99)}) == []
