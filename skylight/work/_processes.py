"""Processes that help: forks that write to shared memory, and workers that are sent pieces."""

import mmap
import multiprocessing
import os
import signal
import traceback
from collections.abc import Callable
from functools import cache
from multiprocessing.reduction import ForkingPickler
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Shaped
from numpy.typing import DTypeLike
from torch import Tensor

from skylight.errors import SkylightError
from skylight.work._memory import release_memory
from skylight.work._progress import Progress

Result = TypeVar("Result")
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


def run_piece(
    prepare: Callable[[], None] | None, work: Callable[..., Result], one: tuple
) -> Result:
    """``work(*one)`` in a worker, prepared for it once and without memory that was used for it."""
    if prepare is not None:
        _prepare_once(prepare)
    result = work(*one)
    release_memory()
    return result


@cache
def _prepare_once(prepare: Callable[[], None]) -> None:
    """``prepare()`` if this process has not done so yet."""
    prepare()


def send_tensors_by_value() -> None:
    """From now on this process sends tensors as their values, which arrive on the CPU.

    PyTorch sends a file descriptor of shared memory for each instead: some hundred for a batch of
    photographs, and containers have as little as 64 MB of such memory.
    """
    ForkingPickler.register(Tensor, _reduced)


def _reduced(tensor: Shaped[Tensor, "*s"]) -> tuple:
    return _again, (tensor.detach().cpu().numpy(),)


def _again(array: Shaped[np.ndarray, "*s"]) -> Shaped[Tensor, "*s"]:
    return torch.from_numpy(array)
