"""Searches for cycles: seldom, and none when a process ends; cycles are still found."""

import gc
import subprocess
import sys
import weakref

SCRIPT = """
import gc, sys
import skylight.cli
skylight.cli.main = lambda: 3  # the command itself
from skylight.__main__ import main
code = main()
print(code, gc.get_threshold()[0], gc.get_freeze_count() > 1000)
"""


class _Own:
    def __init__(self) -> None:
        self.self = self


def test_a_command_searches_seldom_and_leaves_what_there_is_at_its_end() -> None:
    told = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True
    )
    assert told.stdout.split() == ["3", "20000", "True"]


def test_cycles_are_still_found() -> None:
    from skylight.work.garbage import collect_seldom

    before = gc.get_threshold()
    try:
        collect_seldom()
        gone = weakref.ref(_Own())
        kept = [[] for _ in range(30_000)]
        assert gone() is None
        assert len(kept) == 30_000
    finally:
        gc.set_threshold(*before)
