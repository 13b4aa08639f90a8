"""A few kills; ``python tools/kill_runs.py`` is the long run, and tests/training kills training."""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from tests.faults.kills import KILLED, attempt, kill_runs
from tests.faults.scenarios import bundle, capture, film, viewer

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("killed", "kills"), [(capture, 2), (viewer, 2), (bundle, 1), (film, 1)])
def test_what_is_killed_ends_as_what_is_not(killed: ModuleType, kills: int, tmp_path: Path) -> None:
    outcome = kill_runs(killed, tmp_path, kills=kills, seed=1)
    assert outcome.kills == kills
    assert outcome.differences == ()


def scenario(program: str, result: Callable[[Path], str]) -> ModuleType:
    """A Python program that gets the folder, and what is looked at there."""
    found = ModuleType("program")
    found.command = lambda folder: [sys.executable, "-c", program, str(folder)]  # type: ignore[attr-defined]
    found.result = lambda folder: {"result": result(folder)}  # type: ignore[attr-defined]
    return found


def test_what_a_kill_changes_is_told(tmp_path: Path) -> None:
    """A command that forgets how often it was begun ends differently; that must be seen."""
    careless = scenario(
        "import sys, time, pathlib; p = pathlib.Path(sys.argv[1]); p.mkdir(exist_ok=True); "
        "n = len(list(p.iterdir())); (p / str(n)).touch(); time.sleep(1)",
        lambda folder: str(len(list(folder.iterdir()))),
    )
    outcome = kill_runs(careless, tmp_path, kills=3, seed=0)
    assert outcome.kills == 3
    assert outcome.differences


def test_a_command_that_fails_once_after_a_kill_is_told(tmp_path: Path) -> None:
    fragile = scenario(
        "import sys, time, pathlib; p = pathlib.Path(sys.argv[1]); p.mkdir(exist_ok=True); "
        "left = p / 'half'; known = left.exists(); left.unlink(missing_ok=True); "
        "known and sys.exit('something is left'); left.touch(); time.sleep(1); left.unlink(); "
        "(p / 'whole').write_text('all of it')",
        lambda folder: (folder / "whole").read_text(),  # not there after a kill
    )
    outcome = kill_runs(fragile, tmp_path, kills=3, seed=0)
    assert outcome.kills == 3
    assert outcome.differences == tuple(
        f"run {run}: ended with 1: something is left" for run in range(3)
    )


def test_the_whole_group_is_killed(tmp_path: Path) -> None:
    """Children would go on writing."""
    child = f"import time; time.sleep(2); open({str(tmp_path / 'late')!r}, 'w')"
    program = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {child!r}])"
    assert attempt([sys.executable, "-c", program], 0.5) == KILLED
    time.sleep(2.5)
    assert not (tmp_path / "late").exists()
    assert attempt([sys.executable, "-c", program], 30) == ""
    assert (tmp_path / "late").exists()
