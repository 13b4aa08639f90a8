"""Progress on standard error, for people and for programs."""

import json
import os
import subprocess
import sys

import pytest

from skylight.work._progress import LEAST_STEP, counted, stage_bar


def test_programs_read_a_line_for_each_step(capsys: pytest.CaptureFixture[str]) -> None:
    with stage_bar("json") as tell:
        for stage in ("finding the face", "tracing light"):
            for step in range(1001):
                tell(stage, step / 1000)
    told = capsys.readouterr()
    assert told.out == ""
    lines = [json.loads(line) for line in told.err.splitlines()]
    for stage in ("finding the face", "tracing light"):
        shares = [line["share"] for line in lines if line["stage"] == stage]
        assert shares == sorted(shares)
        assert shares[0] == 0
        assert 1 - shares[-1] < LEAST_STEP
        assert 50 < len(shares) <= 1 / LEAST_STEP + 1
    assert [line["stage"] for line in lines] == sorted(line["stage"] for line in lines)


def test_a_stage_that_begins_again_is_told_again(capsys: pytest.CaptureFixture[str]) -> None:
    with stage_bar("json") as tell:
        for share in (0.0, 0.5, 0.0):
            tell("estimating the light", share)
    shares = [json.loads(line)["share"] for line in capsys.readouterr().err.splitlines()]
    assert shares == [0.0, 0.5, 0.0]


def test_nobody_watches_a_bar(capsys: pytest.CaptureFixture[str]) -> None:
    with stage_bar() as tell:
        tell("tracing light", 0.5)
    assert capsys.readouterr().err == ""


def test_a_log_gets_a_line_now_and_then(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 0, 9, ... 90 s: at most one in 20 s, and none at the start."""
    clock = iter(range(0, 1000, 9))
    monkeypatch.setattr("skylight.work._progress.time.monotonic", lambda: next(clock, 0))
    with stage_bar(log_every_s=20.0) as tell:
        for step in range(8):
            tell(f"step {step}", step / 8)
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["step 2", "step 5"]


def test_items_are_counted() -> None:
    told: list[tuple[str, float]] = []
    seen = [len(told) for _ in counted("abcd", "map", lambda *each: told.append(each))]
    assert seen == [1, 2, 3, 4]
    assert [share for _, share in told] == [0, 0.25, 0.5, 0.75]
    assert told[0][0] == "map 0 of 4"
    assert list(counted([], "map", lambda *each: told.append(each))) == []


@pytest.mark.skipif(sys.platform == "win32", reason="has no terminals of this kind")
def test_what_is_printed_under_a_bar_stays_whole_and_goes_to_its_file() -> None:
    """The bar is on a terminal of 80 columns, standard output a pipe."""
    line = "epoch 1  " + 12 * "validation "
    program = f"""
from skylight.work._progress import stage_bar
with stage_bar() as tell:
    tell("step 1 of 2", 0.5)
    print({line!r})
"""
    ours, theirs = os.openpty()
    done = subprocess.run(
        [sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        stderr=theirs,
        text=True,
        check=True,
    )
    os.close(theirs)
    shown = os.read(ours, 100_000).decode()
    os.close(ours)
    assert done.stdout == line + "\n"
    assert "step 1 of 2" in shown
    assert "epoch 1" not in shown
