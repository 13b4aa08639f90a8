"""Memory of long work: how often Python searches for cycles, and what goes back to the system.

Cycles are objects that refer to each other and that nothing else refers to. Nothing here imports
torch: a command asks for it before it knows what it has to do.
"""

import ctypes
import gc
import sys
from collections.abc import Callable
from functools import cache

_CREATED = 100_000  # objects after which the youngest are searched; 700 by default in Python 3.11


def collect_seldom() -> None:
    """For processes that import much: nearly all objects live as long as these do.

    Searches of them all, as imports call for, take 0.3 s of an estimate, and after each 20,000
    still 0.2 s; those of a worker 0.05 s a photograph.
    """
    gc.set_threshold(_CREATED, *gc.get_threshold()[1:])


def collect_no_more() -> None:
    """What there is now is not searched when the process ends, which takes 0.5 s with torch."""
    _freeze()


def release_memory() -> None:
    """For workers, between two pieces of work: gives the system what is not used any more.

    Cycles of objects (figures, graphs of operations) and blocks that glibc keeps grow to 0.2 GB
    over 60 photographs. It takes 0.02 s: what there is at the first call, imports above all, is not
    searched again.
    """
    gc.collect()
    if not gc.get_freeze_count():
        _freeze()
    trim = _malloc_trim()
    if trim is not None:
        trim(0)


def _freeze() -> None:
    """Not with OpenImageIO, whose binding prints every object that is kept as lost at the end."""
    if "OpenImageIO" not in sys.modules:
        gc.freeze()


@cache
def _malloc_trim() -> Callable[[int], int] | None:
    """glibc's; None with other C libraries."""
    try:
        return ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):  # musl, macOS, Windows
        return None
