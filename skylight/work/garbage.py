"""How often Python searches for cycles of objects that nothing refers to any more."""

import gc

_CREATED = 20_000  # objects after which the youngest are searched; 700 by default


def collect_seldom() -> None:
    """For processes that import much: nearly all objects live as long as these do.

    Searches of them all, as imports call for, take 0.3 s of an estimate; those of a worker 0.05 s a
    photograph.
    """
    gc.set_threshold(_CREATED, *gc.get_threshold()[1:])


def collect_no_more() -> None:
    """What there is now is not searched when the process ends, which takes 0.5 s with torch."""
    gc.freeze()
