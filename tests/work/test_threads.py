"""Threads of the command's process, and what may have more of them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from skylight.work import _threads
from skylight.work._threads import ONE_THREAD, cores

# as the command does, without a command: what torch and the environment say then and for training
PROGRAM = """
import os, sys
from skylight.work._threads import prefer_one_thread, use_all_cores
prefer_one_thread()
import torch
print(os.environ.get("OPENBLAS_NUM_THREADS"), torch.get_num_threads(), end=" ")
use_all_cores()
print(torch.get_num_threads())
"""


@pytest.mark.parametrize(
    ("chosen", "expected"), [(None, f"1 1 {cores()}"), ("2", "None 2 2")], ids=["unset", "two"]
)
def test_one_thread_unless_the_user_or_training_asks_for_more(
    chosen: str | None, expected: str
) -> None:
    environment = {name: v for name, v in os.environ.items() if name not in ONE_THREAD}
    if chosen is not None:
        environment["OMP_NUM_THREADS"] = chosen
    told = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True
    )
    assert told.stdout.strip() == expected


@pytest.mark.parametrize(
    ("limit", "expected"),
    [("150000 100000", 2), ("20000 100000", 1), ("max 100000", 3), ("900000 100000", 3)],
)
def test_a_container_may_have_fewer_cores_than_it_sees(
    limit: str, expected: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cpu.max").write_text(f"{limit}\n")
    monkeypatch.setattr(_threads, "_LIMIT", tmp_path / "cpu.max")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2}, raising=False)
    assert cores() == expected


def test_cores_are_those_that_the_process_may_use() -> None:
    if not hasattr(os, "sched_setaffinity"):
        pytest.skip("no affinity of processes on this system")
    own = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(own)})
    try:
        assert cores() == 1
    finally:
        os.sched_setaffinity(0, own)
