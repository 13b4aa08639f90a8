"""A batch that is killed, or loses workers, ends as an uninterrupted one does."""

import json
import os
import random
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.dask_cluster import dask_cluster
from tests.faults.scenarios import batch

pytestmark = pytest.mark.slow

WAIT_S = 300
FACES, PHOTOS = 3, 5


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


def done(folder: Path) -> dict[str, int]:
    """Photos whose estimate is finished, and when its results were written, ns."""
    manifest = folder / "out" / "manifest.jsonl"
    told = manifest.read_text(encoding="utf-8") if manifest.exists() else ""
    entries = [json.loads(line) for line in told.splitlines(keepends=True) if line.endswith("\n")]
    return {
        entry["source"]: (folder / "out" / entry["results"] / "probe.exr").stat().st_mtime_ns
        for entry in entries
        if entry["status"] == "done"
    }


def wait_for_one(folder: Path) -> dict[str, int]:
    for _ in range(20 * WAIT_S):
        if found := done(folder):
            return found
        time.sleep(0.05)
    raise TimeoutError


def test_a_killed_batch_goes_on(tmp_path: Path, undisturbed: dict[str, str]) -> None:
    process = subprocess.Popen(
        batch.command(tmp_path, FACES, workers=1),
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    before = wait_for_one(tmp_path)
    time.sleep(random.Random(0).uniform(0, 0.5))  # into the next photo
    os.killpg(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert len(before) < FACES
    run(batch.command(tmp_path, workers=1))
    assert batch.result(tmp_path) == undisturbed
    assert before.items() <= done(tmp_path).items()  # not done again


def test_a_cluster_that_loses_a_worker_goes_on(tmp_path: Path, undisturbed: dict[str, str]) -> None:
    pytest.importorskip("distributed", reason="dask is not installed")
    (tmp_path / "dask").mkdir()
    with dask_cluster(tmp_path / "dask", workers=2) as cluster:
        command = batch.command(tmp_path, FACES)
        command[command.index("--workers") :] = ["--cluster", cluster.address]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        before = wait_for_one(tmp_path)
        cluster.workers[0].kill()
        _, errors = process.communicate(timeout=WAIT_S)
        assert process.returncode == 0, errors
    assert batch.result(tmp_path) == undisturbed
    assert before.items() <= done(tmp_path).items()
