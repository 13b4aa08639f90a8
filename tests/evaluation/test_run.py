"""Running, resuming and writing down, with an evaluation that costs nothing."""

import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from skylight.errors import InputError
from skylight.evaluation._main import evaluate, run_evaluation
from skylight.evaluation._run import CACHE, Check, Item, measure_all


@dataclass(frozen=True, kw_only=True)
class Counting:
    """Items 0..count-1, whose value is their number; each measurement leaves a mark."""

    count: int
    marks: Path
    seed: int = 1
    name: str = "counting"

    def config(self):
        return {"seed": self.seed}

    def items(self):
        return [str(i) for i in range(self.count)]

    def measure(self, item, picture):
        with self.marks.open("a") as stream:
            stream.write(f"{item}\n")
        if item == "3":
            raise InputError("3 cannot be measured")
        return Item(name=item, metrics={"method": {"mae": float(item)}})

    def checks(self, rows, items):
        return {"mean": Check.at_most(rows["method"]["mae"]["mean"], 0.0)}


@pytest.fixture
def marks(tmp_path):
    return tmp_path / "marks"


def measured(marks):
    return marks.read_text().split()


def test_statistics_and_checks_are_written_and_a_missed_goal_is_no_error(tmp_path, marks):
    path = run_evaluation(Counting(count=3, marks=marks), tmp_path / "out", command="c")
    results = json.loads(path.read_text())
    assert results["rows"]["method"]["mae"] == pytest.approx(
        {"mean": 1.0, "median": 1.0, "std": (2 / 3) ** 0.5, "n": 3}
    )
    assert results["checks"]["mean"] == {"value": 1.0, "goal": "<= 0", "ok": False}
    assert results["n"] == 3
    table = (path.parent / "results.md").read_text()
    assert "| MAE (s) | 1 ± 0.82 [1] |" in table
    assert "| mean | 1 | <= 0 | no |" in table


def test_what_was_measured_is_not_measured_again(tmp_path, marks):
    out = tmp_path / "out"
    first = measure_all(Counting(count=2, marks=marks), out, workers=1)
    more = measure_all(Counting(count=3, marks=marks), out, workers=1)
    assert measured(marks) == ["0", "1", "2"]
    assert more[:2] == first


@pytest.mark.slow
def test_two_processes_measure_the_same(tmp_path, marks):
    here = measure_all(Counting(count=4, marks=marks), tmp_path / "here", workers=1)
    there = measure_all(Counting(count=4, marks=marks), tmp_path / "there", workers=2)
    assert here == there
    assert sorted(measured(marks)) == sorted("01230123")


def test_a_line_cut_off_by_a_kill_is_measured_again(tmp_path, marks):
    out = tmp_path / "out"
    whole = measure_all(Counting(count=3, marks=marks), out, workers=1)
    cache = out / CACHE
    cache.write_text(cache.read_text()[:-10])
    assert measure_all(Counting(count=3, marks=marks), out, workers=1) == whole
    assert measured(marks) == ["0", "1", "2", "2"]


def test_results_of_other_settings_are_not_taken(tmp_path, marks):
    measure_all(Counting(count=1, marks=marks), tmp_path / "out", workers=1)
    measure_all(Counting(count=1, marks=marks, seed=2), tmp_path / "out", workers=1)
    assert measured(marks) == ["0", "0"]


def test_an_item_with_a_problem_is_named_and_left_out(tmp_path, marks):
    path = run_evaluation(Counting(count=4, marks=marks), tmp_path / "out", command="c")
    results = json.loads(path.read_text())
    assert results["problems"] == {"3": "3 cannot be measured"}
    assert results["rows"]["method"]["mae"]["n"] == 3


def test_unknown_names_are_answered_with_the_known_ones(tmp_path):
    with pytest.raises(InputError, match="sky-models, real-faces"):
        evaluate("faces", quick=True, data=None, out=tmp_path)


def test_real_faces_asks_for_data(tmp_path):
    with pytest.raises(InputError, match="--data"):
        evaluate("real-faces", quick=True, data=None, out=tmp_path)
    with pytest.raises(InputError, match=r"index\.json"):
        evaluate("real-faces", quick=True, data=tmp_path, out=tmp_path / "out")
