"""Work shared by forked processes with shared memory.

How often Python searches for cycles of objects that nothing refers to any more, and what becomes
of their memory.
"""

import ctypes
import gc
import mmap
import multiprocessing
import os
import signal
import traceback
from collections.abc import Callable
from functools import cache

import numpy as np
from jaxtyping import Shaped
from numpy.typing import DTypeLike

from skylight.errors import SkylightError
from skylight.work._progress import Progress

Work = Callable[[int], None]


def shared_array(shape: tuple[int, ...], dtype: DTypeLike) -> Shaped[np.ndarray, "*s"]:
    """Zeros in anonymous memory that forked processes write to as well; freed with the array.

    Pages that nobody touches take no memory.
    """
    count = int(np.prod(shape, dtype=np.int64))
    size = max(1, count * np.dtype(dtype).itemsize)
    try:
        memory = mmap.mmap(-1, size)
    except OSError as error:
        raise MemoryError(f"{size / 1e9:.1f} GB of memory cannot be had") from error
    return np.frombuffer(memory, dtype, count).reshape(shape)


def in_processes(
    work: Work, count: int, *, workers: int = 1, progress: Progress | None = None
) -> None:
    """``work(i)`` for each i below ``count``, by this process and ``workers - 1`` forked ones.

    What it makes must go to :func:`shared_array`. However this ends (Ctrl-C, an error here or in
    another process), no process is left. More than one worker needs ``fork`` (not on Windows).
    """
    if workers < 1:
        raise ValueError(f"workers must be 1 or more, got {workers}")
    import torch  # here: every command begins with this module, and not all need it

    parent = os.getpid()

    def help_out(share: range) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; the parent decides
        torch.set_num_threads(1)  # a fork has lost torch's threads and would wait for them
        # Python's own way out would wait for the threads of pools, which the fork has lost
        try:
            for i in share:
                if os.getppid() != parent:
                    break
                work(i)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)

    # Interleaved shares take about equally long, so this process's progress stands for all.
    shares = [range(k, count, workers) for k in range(workers)]
    context = multiprocessing.get_context("fork") if workers > 1 else None
    helpers = [context.Process(target=help_out, args=(s,)) for s in shares[1:]] if context else []
    try:
        for helper in helpers:
            helper.start()
        for done, i in enumerate(shares[0], 1):
            work(i)
            if progress is not None:
                progress(done / len(shares[0]))
        for helper in helpers:
            helper.join()
            if helper.exitcode != 0:
                raise SkylightError(
                    f"a helping process died with exit code {helper.exitcode}; where memory is "
                    "short, ask for fewer workers"
                )
    finally:
        for helper in helpers:
            if helper.is_alive():
                helper.terminate()
                helper.join()


_CREATED = 20_000  # objects after which the youngest are searched; 700 by default in Python 3.11


def collect_seldom() -> None:
    """For processes that import much: nearly all objects live as long as these do.

    Searches of them all, as imports call for, take 0.3 s of an estimate; those of a worker 0.05 s a
    photograph.
    """
    gc.set_threshold(_CREATED, *gc.get_threshold()[1:])


def collect_no_more() -> None:
    """What there is now is not searched when the process ends, which takes 0.5 s with torch."""
    gc.freeze()


def release_memory() -> None:
    """For workers, between two pieces of work: gives the system what is not used any more.

    Cycles of objects (figures, graphs of operations) and blocks that glibc keeps grow to 0.2 GB
    over 60 photographs. It takes 0.02 s: what there is at the first call, imports above all, is not
    searched again.
    """
    gc.collect()
    if not gc.get_freeze_count():
        gc.freeze()
    trim = _malloc_trim()
    if trim is not None:
        trim(0)


@cache
def _malloc_trim() -> Callable[[int], int] | None:
    """glibc's; None with other C libraries."""
    try:
        return ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):  # musl, macOS, Windows
        return None
