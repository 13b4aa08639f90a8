"""A dask cluster of processes on this machine, each of which a test may kill."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[1]
LOCAL = ("--host", "127.0.0.1", "--no-dashboard")


@dataclass
class DaskCluster:
    address: str
    folder: Path
    scheduler: subprocess.Popen
    workers: list[subprocess.Popen] = field(default_factory=list)

    def keep(self, count: int) -> None:
        """Have so many living workers."""
        self.workers = [worker for worker in self.workers if worker.poll() is None]
        for worker in self.workers[count:]:
            worker.kill()
            worker.wait()
        self.workers = self.workers[:count]
        while len(self.workers) < count:
            self.add_worker()

    def add_worker(self, threads: int = 1) -> None:
        """A worker without the nanny that would start it again."""
        options = ("--no-nanny", "--nthreads", str(threads), "--local-directory", str(self.folder))
        self.workers.append(_dask("worker", self.address, *LOCAL, *options))


@contextmanager
def dask_cluster(folder: Path, workers: int) -> Iterator[DaskCluster]:
    """A scheduler and its workers; ``folder`` takes their files."""
    file = folder / "scheduler.json"
    scheduler = _dask("scheduler", *LOCAL, "--port", "0", "--scheduler-file", str(file))
    cluster = DaskCluster(address="", folder=folder, scheduler=scheduler)
    try:
        for _ in range(1200):
            if file.exists() and file.read_text().endswith("}"):
                break
            time.sleep(0.1)
        cluster.address = json.loads(file.read_text())["address"]
        cluster.keep(workers)
        yield cluster
    finally:
        cluster.keep(0)
        scheduler.kill()
        scheduler.wait()


def _dask(*arguments: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments],
        cwd="/",  # not where the work comes from
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
