"""Searches for cycles: seldom, and none when a process ends; cycles are still found, and their
memory goes back."""

import gc
import platform
import subprocess
import sys
import weakref

import pytest

SCRIPT = """
import gc, sys
import skylight.cli
skylight.cli.main = lambda: 3  # the command itself
from skylight.__main__ import main
code = main()
print(code, gc.get_threshold()[0], gc.get_freeze_count() > 1000)
"""

# blocks of less than malloc maps by itself, held by cycles; the last of all keeps the heap's end
RELEASING = """
import weakref
from skylight.work._memory import collect_seldom, release_memory

class Own:  # a cycle that lives through a call and is given up before the next
    def __init__(self):
        self.self = self

release_memory()
kept = Own()
gone = weakref.ref(kept)
release_memory()
del kept
release_memory()
assert gone() is None

def resident_mb():
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 1e6

collect_seldom()
for _ in range(2):
    release_memory()
    before = resident_mb()
    cycles = [[bytearray(100_000)] for _ in range(2000)]
    for cycle in cycles:
        cycle.append(cycle)
    end = bytearray(100_000)
    full = resident_mb()
    del cycle, cycles
    kept = resident_mb()
    release_memory()
    print(full - before, kept - before, resident_mb() - before)
"""


class _Own:
    def __init__(self) -> None:
        self.self = self


def test_a_command_searches_seldom_and_leaves_what_there_is_at_its_end() -> None:
    told = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True
    )
    assert told.stdout.split() == ["3", "100000", "True"]


def test_cycles_are_still_found() -> None:
    from skylight.work._memory import collect_seldom

    before = gc.get_threshold()
    try:
        collect_seldom()
        gone = weakref.ref(_Own())
        kept = [[] for _ in range(120_000)]
        assert gone() is None
        assert len(kept) == 120_000
    finally:
        gc.set_threshold(*before)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="memory goes back by glibc only")
def test_memory_of_cycles_goes_back_to_the_system() -> None:
    """Also of one that a piece of work leaves to the next."""
    told = subprocess.run(
        [sys.executable, "-c", RELEASING], capture_output=True, text=True, check=True
    )
    for line in told.stdout.splitlines():
        full, kept, released = map(float, line.split())
        assert full > 190
        assert kept > 190
        assert released < 10


@pytest.mark.parametrize("call", ["collect_no_more", "release_memory"])
def test_openimageio_says_nothing_when_a_process_ends(call: str) -> None:
    script = f"import OpenImageIO\nfrom skylight.work import _memory\n_memory.{call}()"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
