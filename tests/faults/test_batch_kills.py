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


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("undisturbed")
    run(batch.command(folder))
    result = batch.result(folder)
    assert result["lines"] == "7"
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
    draw = random.Random(0)
    for count in (1, 3):
        process = subprocess.Popen(
            batch.command(tmp_path),
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        wait_for_lines(tmp_path, count)
        time.sleep(draw.uniform(0, 1))
        os.killpg(process.pid, signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
        assert count <= lines(tmp_path) < 7
    run(batch.command(tmp_path))
    assert batch.result(tmp_path) == undisturbed


def test_a_cluster_that_loses_a_worker_goes_on(tmp_path: Path, undisturbed: dict[str, str]) -> None:
    pytest.importorskip("distributed", reason="dask is not installed")
    (tmp_path / "dask").mkdir()
    with dask_cluster(tmp_path / "dask", workers=2) as cluster:
        command = batch.command(tmp_path)
        command[command.index("--workers") :] = ["--cluster", cluster.address]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        wait_for_lines(tmp_path, 3)
        cluster.workers[0].kill()
        _, errors = process.communicate(timeout=WAIT_S)
        assert process.returncode == 0, errors
    assert batch.result(tmp_path) == undisturbed
