"""Running, resuming and writing down, with an evaluation that costs nothing."""

import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from skylight.errors import InputError
from skylight.evaluation import _main as main
from skylight.evaluation._main import evaluate, evaluate_all, run_evaluation
from skylight.evaluation._run import (
    CACHE,
    Check,
    Evaluation,
    Item,
    measure_all,
    mesh_files,
    probes_folder,
)
from skylight.io._atomic import PARTIAL
from skylight.work._resumable import locked

USUAL = ("bunny.ply", "dragon.ply")


@dataclass(frozen=True, kw_only=True)
class Counting(Evaluation):
    """Items 0..count-1, whose value is their number; each measurement leaves a mark."""

    title = "counting"

    count: int
    marks: Path

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


def with_files(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


def test_probes_are_in_hdr_or_in_the_folder_itself(tmp_path: Path) -> None:
    with_files(tmp_path, "a/hdr/index.csv", "b/index.csv", "c/hdr/map.exr")
    assert probes_folder(tmp_path / "a") == tmp_path / "a/hdr"
    assert probes_folder(tmp_path / "b") == tmp_path / "b"
    with pytest.raises(InputError):
        probes_folder(tmp_path / "c")


def test_other_meshes_stand_in_for_missing_ones(tmp_path: Path) -> None:
    def found(*names: str) -> list[str]:
        folder = tmp_path / "-".join(names).replace("/", "_")
        with_files(folder, "hdr/index.csv", *names)
        from_all, from_maps = (mesh_files(f, USUAL) for f in (folder, folder / "hdr"))
        assert from_all == from_maps
        return [path.name for path in from_all]

    assert found("meshes/a.ply", "meshes/bunny.ply", "meshes/dragon.ply") == list(USUAL)
    assert found("meshes/a.ply", "meshes/b.obj", "meshes/dragon.ply") == ["dragon.ply", "a.ply"]
    assert found("meshes/a.ply", "meshes/notes.txt") == ["a.ply"]
    with pytest.raises(InputError):
        found("meshes/notes.txt")


@pytest.fixture
def told(monkeypatch, tmp_path):
    """The data that each of three evaluations, of other folders, was given."""
    given = {}

    def counting(title, folder):
        def over(data, *, quick):
            given[title] = data
            if data is not None and not data.is_dir():
                raise InputError(f"{data}: there is no | such folder")
            return Counting(count=2, marks=tmp_path / "marks")

        return type(title, (Counting,), {"data_folder": folder, "over": staticmethod(over)})

    folders = {"sky-models": None, "lamps": "lamps", "voxel-probe": ""}
    table = {title: counting(title, folder) for title, folder in folders.items()}
    monkeypatch.setattr(main, "EVALUATIONS", table)
    return given


def test_one_page_has_what_was_measured_and_what_was_left_out_and_why(tmp_path, told):
    data, out = tmp_path / "data", tmp_path / "out"
    data.mkdir()
    (out / "sky-models").mkdir(parents=True)
    (out / "sky-models" / "curve.png").touch()  # this evaluation has no pictures of its own
    page = evaluate_all(quick=True, data=data, out=out, workers=1)
    assert told == {"sky-models": None, "lamps": data / "lamps", "voxel-probe": data}
    text = page.read_text()
    assert "| lamps | 0.0 | left out: " in text
    assert "there is no / such folder |" in text  # a table's cell ends with a stroke
    assert "\n## voxel-probe\n" in text
    assert "\n## lamps\n" not in text
    assert "| MAE (s) | 0.5 ± 0.5 [0.5] |" in text
    assert "![sky-models: curve.png](sky-models/curve.png)" in text
    assert measured(tmp_path / "marks") == ["0", "1", "0", "1"]
    evaluate_all(quick=True, data=data, out=out, workers=1)
    assert measured(tmp_path / "marks") == ["0", "1", "0", "1"]  # it goes on


def test_without_any_result_it_is_refused(tmp_path, told):
    with pytest.raises(InputError, match="no such folder"):
        evaluate_all(quick=True, data=tmp_path / "none", out=tmp_path / "out")
    told.clear()
    (tmp_path / "data").mkdir()
    with pytest.raises(InputError, match=r"nothing could be evaluated; .*results\.md"):
        evaluate_all(quick=True, data=tmp_path / "data", out=tmp_path / "out", workers=0)


def test_a_folder_is_for_one_run_at_a_time(tmp_path, marks):
    """And what a killed run has left half written among its pictures goes."""
    out = tmp_path / "out"
    half = out / "pictures" / f"{PARTIAL}1.png"
    half.parent.mkdir(parents=True)
    half.touch()
    with locked(out), pytest.raises(InputError, match="another run"):
        measure_all(Counting(count=1, marks=marks), out, workers=1)
    measure_all(Counting(count=1, marks=marks), out, workers=1)
    assert not half.exists()


def test_titles_of_a_page_within_another_go_one_deeper(tmp_path):
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / main.PAGE).write_text("# One\n# Rows\n## Of a kind\ntext #1\n")
    assert main._section(tmp_path, "one") == ["## one", "## Rows\n### Of a kind\ntext #1"]
