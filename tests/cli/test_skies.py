"""`skylight skies` from end to end."""

from pathlib import Path
from typing import get_args

import pytest

from skylight.cli import main
from skylight.skies._command import MapLayout
from skylight.skies._layouts import Layout
from skylight.work._progress import with_time_left
from tests.cli.test_cli import one_line


def test_simulate_then_index(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, other = tmp_path / "skies", tmp_path / "other.csv"
    arguments = ["--days", "1", "--out", str(folder), "--interval", "400", "--overcast", "2"]
    assert main(["skies", "simulate", *arguments]) == 0
    count = len(list(folder.glob("*.exr")))
    assert f"index.csv: {count} skies of 1 day(s) ({count} train" in capsys.readouterr().out
    assert main(["skies", "index", str(folder)]) == 2
    assert "indexes simulated skies" in one_line(capsys)
    assert main(["skies", "index", str(folder), "--out", str(other)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == count + 1
    assert all("skylatlong, day 2" in line and "no sun" in line for line in lines[:-1])
    assert lines[-1].startswith(f"{other}: {count} skies of 1 day(s) ({count} train, ")
    assert lines[-1].endswith(", 0 refused, 0 left out")


def test_time_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the pace of what was done since the start: 2 of 10 in 8 s leave 5 for 20 s."""
    clock = iter([100.0, 108.0, 508.0, 20_100.0])
    monkeypatch.setattr("skylight.work._progress.time.monotonic", lambda: next(clock))
    told: list[tuple[str, float]] = []
    progress = with_time_left("day", lambda stage, share: told.append((stage, share)))
    for done in (3, 5, 7, 8):
        progress(done, 10)
    assert told == [
        ("day 3 of 10", 0.3),
        ("day 5 of 10, 20 s left", 0.5),
        ("day 7 of 10, 5 min left", 0.7),
        ("day 8 of 10, 2.2 h left", 0.8),
    ]


def test_layouts_are_those_of_the_library() -> None:
    assert get_args(MapLayout) == ("auto", *get_args(Layout))


@pytest.mark.parametrize(
    "wrong",
    [
        ["--size", "32x64"],
        ["--size", "big"],
        ["--days", "0"],
        ["--interval", "-5"],
        ["--clear", "-1"],
        ["--broken", "nan"],
        ["--overcast", "0"],
    ],
)
def test_wrong_numbers(
    wrong: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    days = [] if "--days" in wrong else ["--days", "1"]
    out = ["--out", str(tmp_path / "skies")]
    assert main(["skies", "simulate", *days, *out, *wrong]) == 2
    assert wrong[0] in one_line(capsys)


def test_no_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["skies", "index", str(tmp_path / "nowhere")]) == 2
    assert "no such folder" in one_line(capsys)
