"""A batch that is killed, or loses workers, ends where an undisturbed one does."""

import os
import random
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.dask_cluster import dask_cluster
from tests.faults.scenarios import batch

WAIT_S = 300
FACES, PHOTOS = 2, 4


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """By one worker: how many there are makes no difference either."""
    folder = tmp_path_factory.mktemp("undisturbed")
    run(batch.command(folder, FACES, workers=1))
    result = batch.result(folder)
    assert result["lines"] == str(PHOTOS)
    return result


def run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, timeout=WAIT_S)
    assert done.returncode == 0, done.stderr


def lines(folder: Path) -> int:
    manifest = folder / "out" / "manifest.jsonl"
    return manifest.read_bytes().count(b"\n") if manifest.exists() else 0


def wait_for_lines(folder: Path, count: int) -> None:
    for _ in range(20 * WAIT_S):
        if lines(folder) >= count:
            return
        time.sleep(0.05)
    raise TimeoutError


def test_a_killed_batch_goes_on(tmp_path: Path, undisturbed: dict[str, str]) -> None:
    process = subprocess.Popen(
        batch.command(tmp_path, FACES),
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    wait_for_lines(tmp_path, 1)
    time.sleep(random.Random(0).uniform(0, 0.5))  # into the next photo
    os.killpg(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert 1 <= lines(tmp_path) < PHOTOS
    run(batch.command(tmp_path, workers=1))
    assert batch.result(tmp_path) == undisturbed


def test_a_cluster_that_loses_a_worker_goes_on(tmp_path: Path, undisturbed: dict[str, str]) -> None:
    pytest.importorskip("distributed", reason="dask is not installed")
    (tmp_path / "dask").mkdir()
    with dask_cluster(tmp_path / "dask", workers=2) as cluster:
        command = batch.command(tmp_path, FACES)
        command[command.index("--workers") :] = ["--cluster", cluster.address]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        wait_for_lines(tmp_path, 1)
        cluster.workers[0].kill()
        _, errors = process.communicate(timeout=WAIT_S)
        assert process.returncode == 0, errors
    assert batch.result(tmp_path) == undisturbed
