"""Work on a dask cluster of real processes, some of which are killed."""

import logging
import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

pytest.importorskip("distributed", reason="dask is not installed")

from skylight.errors import DependencyError, InputError, SkylightError
from skylight.work import _cluster as module
from skylight.work._cluster import Cluster
from skylight.work._resumable import share_work
from tests.dask_cluster import DaskCluster, dask_cluster


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    """Starting a worker takes seconds, so tests share them and say how many must live."""
    with dask_cluster(tmp_path_factory.mktemp("dask"), workers=2) as cluster:
        yield cluster


def _prepare() -> None:
    os.environ["PREPARED"] = os.environ.get("PREPARED", "") + "x"


def _piece(folder: Path, number: int, seconds: float) -> tuple[int, int, int, str, str]:
    """Writes a file that is the same whoever writes it."""
    with (folder / "begun").open("a") as file:
        file.write(f"{number}\n")
    time.sleep(seconds)
    (folder / f"{number}.txt").write_text(str(number**2))
    return number, os.getpid(), torch.get_num_threads(), os.environ["PREPARED"], os.getcwd()


def _fail(number: int) -> None:
    raise InputError(f"piece {number}")


def _die(number: int) -> int:
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_pieces_come_once_from_prepared_workers_of_one_thread(
    dask: DaskCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dask.keep(2)
    monkeypatch.chdir(tmp_path)  # relative paths mean the same on workers
    work = [(Path("."), number, 0.1) for number in range(8)]
    where = Cluster(address=dask.address, folder=tmp_path)
    results = list(share_work(_piece, work, workers=where, prepare=_prepare))
    assert sorted(number for number, *_ in results) == list(range(8))
    assert {pid for _, pid, *_ in results} <= {worker.pid for worker in dask.workers}
    assert {r[2:] for r in results} == {(1, "x", str(tmp_path))}
    assert {file.name for file in tmp_path.iterdir()} == {"begun", *(f"{n}.txt" for n in range(8))}


@pytest.mark.slow
def test_a_killed_worker_loses_nothing_and_doubles_nothing(
    dask: DaskCluster, tmp_path: Path
) -> None:
    dask.keep(2)
    work = [(tmp_path, number, 0.1) for number in range(16)]
    numbers, pids, came_before = [], [], []
    where = Cluster(address=dask.address, folder=tmp_path)
    for number, pid, *_ in share_work(_piece, work, workers=where, prepare=_prepare):
        numbers.append(number)
        pids.append(pid)
        if not came_before and len(numbers) >= 8 and len(set(pids)) == 2:
            came_before = list(numbers)
            time.sleep(0.3)  # the scheduler hears that they came
            dask.workers[0].kill()
    assert Counter(numbers) == Counter(range(16))
    assert set(pids) == {worker.pid for worker in dask.workers}
    begun = Counter(map(int, (tmp_path / "begun").read_text().split()))
    assert {begun[number] for number in came_before} == {1}
    assert {f.name: f.read_text() for f in tmp_path.glob("*.txt")} == {
        f"{n}.txt": str(n**2) for n in range(16)
    }


def test_a_failure_reaches_the_caller(dask: DaskCluster, tmp_path: Path) -> None:
    dask.keep(1)
    where = Cluster(address=dask.address, folder=tmp_path)
    with pytest.raises(InputError, match="piece"):
        list(share_work(_fail, [(1,), (2,)], workers=where))
    assert list(tmp_path.iterdir()) == []


def test_files_must_be_visible(dask: DaskCluster, tmp_path: Path) -> None:
    dask.keep(1)
    where = Cluster(address=dask.address, folder=tmp_path)
    work = [(tmp_path, number, 0.2) for number in range(8)]
    results = share_work(_piece, work, workers=where, prepare=_prepare)
    next(results)
    for mark in tmp_path.glob(".partial-*"):
        mark.unlink()  # as on a machine with another file system
    with pytest.raises(InputError, match=r"does not see .* a file system that all machines share"):
        list(results)


@pytest.mark.slow
def test_a_piece_that_kills_its_workers_is_answered_for(dask: DaskCluster, tmp_path: Path) -> None:
    from distributed import Client

    where = Cluster(address=dask.address, folder=tmp_path)
    with Client(dask.address, set_as_default=False) as client:
        client.run_on_scheduler(_allow_failures, 0)
        try:
            dask.keep(1)
            results = share_work(_die, [(1,)], workers=where, lost=lambda number: -number)
            assert list(results) == [-1]
            dask.keep(1)
            with pytest.raises(SkylightError, match="killed again and again"):
                list(share_work(_die, [(1,)], workers=where))
        finally:
            client.run_on_scheduler(_allow_failures, 3)


def _allow_failures(count: int, dask_scheduler: Any) -> None:
    dask_scheduler.allowed_failures = count


@pytest.mark.slow
def test_workers_may_come_late_but_not_with_threads(
    dask: DaskCluster, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    dask.keep(0)
    adding = threading.Timer(0.5, dask.add_worker, kwargs={"threads": 2})
    adding.start()
    where = Cluster(address=dask.address, folder=tmp_path)
    with caplog.at_level(logging.WARNING), pytest.raises(InputError, match="--nthreads 1"):
        list(share_work(_die, [(2,)], workers=where))
    adding.join()
    assert "no worker has joined" in caplog.text
    dask.keep(0)


@pytest.mark.slow
def test_a_lost_scheduler_ends_the_run(tmp_path: Path) -> None:
    with dask_cluster(tmp_path, workers=0) as cluster:
        killing = threading.Timer(0.5, cluster.scheduler.kill)
        killing.start()
        where = Cluster(address=cluster.address, folder=tmp_path)
        with pytest.raises(SkylightError, match="went away"):
            list(share_work(_die, [(2,)], workers=where))
        killing.join()


def test_what_is_missing_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scheduler; the extra."""
    monkeypatch.setattr(module, "CONNECT_S", 0.5)
    where = Cluster(address="tcp://127.0.0.1:9", folder=tmp_path)
    with pytest.raises(InputError, match="no dask scheduler at tcp:"):
        list(share_work(_fail, [(1,), (2,)], workers=where))
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(DependencyError, match=r"skylight-lighting\[cluster\]"):
        list(share_work(_fail, [(1,), (2,)], workers=where))
