"""Work on skies by all cores."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

import torch

from skylight.errors import SkylightError

Job = TypeVar("Job")
Result = TypeVar("Result")


def in_order(work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
    """``work(job)`` of all jobs in their order, by as many processes as cores.

    Raises
    ------
    SkylightError
        A process died, as one does where memory is short.
    """
    workers = min(os.cpu_count() or 1, len(jobs))
    if workers <= 1:
        yield from map(work, jobs)
        return
    # spawned, because a process that has run torch's threads cannot be forked safely
    with ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=torch.set_num_threads,
        initargs=(1,),
    ) as pool:
        try:
            yield from pool.map(work, jobs)
        except BrokenProcessPool as error:
            raise SkylightError(
                "a process that worked on skies died; where memory is short, let the same command "
                "run alone, and again"
            ) from error
