"""Forked processes and their failures; tensors that are sent to other processes."""

import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.reduction import ForkingPickler

import numpy as np
import pytest
import torch
from torch.multiprocessing.reductions import init_reductions

from skylight.errors import SkylightError
from skylight.work._processes import in_processes, send_tensors_by_value, shared_array


@pytest.mark.parametrize("workers", [1, 3])
def test_all_work_is_done_once_and_the_share_grows_to_one(workers):
    done, seen = shared_array((10,), np.int32), []

    def work(i: int) -> None:
        done[i] += i + 1

    in_processes(work, 10, workers=workers, progress=seen.append)
    assert done.tolist() == list(range(1, 11))
    assert seen == sorted(seen)
    assert seen[-1] == 1


def test_without_workers_nothing_is_done():
    with pytest.raises(ValueError, match="workers must be 1 or more, got 0"):
        in_processes(lambda _: None, 3, workers=0)


def test_nothing_runs_on_after_an_error():
    def work(i: int) -> None:
        if i == 0:
            raise ValueError("here")
        time.sleep(60)

    with pytest.raises(ValueError, match="here"):
        in_processes(work, 3, workers=3)
    assert not multiprocessing.active_children()


def test_the_death_of_a_helper_is_told():
    with pytest.raises(SkylightError, match="exit code 3"):
        in_processes(lambda i: os._exit(3) if i else None, 2, workers=2)


def test_an_interrupt_ends_all_processes_and_says_so_once():
    # a job in a shell's background starts with interrupts ignored
    program = """
import signal, time
from skylight.errors import SkylightError
from skylight.work._processes import in_processes
signal.signal(signal.SIGINT, signal.default_int_handler)
print("on", flush=True)
in_processes(lambda i: time.sleep(0.2), 1000, workers=3)
"""
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(0.5)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, errors = process.communicate(timeout=20)
    assert errors.count(b"KeyboardInterrupt") == 1
    with pytest.raises(ProcessLookupError):  # nobody is left of the group
        os.killpg(process.pid, 0)


def test_threads_of_a_pool_may_fork():
    """What Python does at a process's end would wait in a helper for threads that it has not."""

    def count(start: int) -> list[int]:
        made = shared_array((8,), np.int64)

        def work(i: int) -> None:
            made[i] = start + i

        in_processes(work, 8, workers=2)
        return made.tolist()

    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(count, (0, 100, 200, 300)))
    assert found == [list(range(start, start + 8)) for start in (0, 100, 200, 300)]


def test_threads_of_a_pool_may_have_helpers_that_fail():
    def work(i: int) -> None:
        if i == 1:
            raise ValueError("in the helper")

    def fail(_: int) -> None:
        in_processes(work, 2, workers=2)

    with ThreadPoolExecutor(2) as pool:
        for made in [pool.submit(fail, n) for n in range(4)]:
            assert isinstance(made.exception(timeout=30), SkylightError)


def test_tensors_are_sent_without_shared_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever they look at."""

    def sent(tensor: torch.Tensor) -> bytes:
        return bytes(ForkingPickler.dumps(tensor))

    monkeypatch.setattr(ForkingPickler, "_extra_reducers", {**ForkingPickler._extra_reducers})
    init_reductions()  # in a process that has sent by value already
    assert b"rebuild_storage" in sent(torch.ones(3))  # what PyTorch does: the test would see it
    send_tensors_by_value()
    grown = torch.arange(6.0).reshape(2, 3).requires_grad_()
    some = [torch.tensor(3.0), torch.ones(1, 3).expand(4, 3), grown, grown.T, torch.zeros(0, 2)]
    for tensor in some:
        there = pickle.loads(sent(tensor))
        assert b"rebuild_storage" not in sent(tensor)
        assert torch.equal(there, tensor)
        assert there.dtype == tensor.dtype
        assert not there.requires_grad
