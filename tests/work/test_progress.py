"""Progress on standard error, for people and for programs."""

import json

import pytest

from skylight.work._progress import LEAST_STEP, stage_bar


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
