"""A worker process that cannot be started, or is stopped while it starts."""

import asyncio
import errno
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from skylight.studio._jobs import TaskStopped, WorkerProcess


def run(work: Coroutine[Any, Any, Any]) -> Any:
    """In a thread of its own: the main one may hold the loop of the browser's driver."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(asyncio.run, work).result()


def test_a_process_that_cannot_be_started_is_tried_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    start = asyncio.create_subprocess_exec

    async def no_memory(*_: object, **__: object) -> None:
        raise OSError(errno.ENOMEM, "out of memory")

    async def all_of_it() -> dict[str, Any]:
        worker = WorkerProcess(["json"], tmp_path)
        monkeypatch.setattr(asyncio, "create_subprocess_exec", no_memory)
        await worker.warm()  # or else the loop over jobs would end here
        with pytest.raises(OSError, match="out of memory"):
            await worker.run("warm", {"modules": []})
        monkeypatch.setattr(asyncio, "create_subprocess_exec", start)
        try:
            return await worker.run("warm", {"modules": []})
        finally:
            await worker.close()

    assert run(all_of_it()) == {}


def test_a_stop_while_the_last_process_ends_counts(tmp_path: Path) -> None:
    async def all_of_it() -> None:
        worker = WorkerProcess(["json"], tmp_path)
        await worker.warm()
        worker.stop()
        task = asyncio.create_task(worker.run("warm", {"modules": []}))
        await asyncio.sleep(0)  # it waits for the end of the stopped one
        worker.stop()
        try:
            with pytest.raises(TaskStopped):
                await task
        finally:
            await worker.close()

    run(all_of_it())


def test_what_libraries_leave_behind_is_in_its_own_folder(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (own := tmp_path / "own").mkdir()
    (everyones := tmp_path / "everyones").mkdir()
    monkeypatch.setenv("TMPDIR", str(everyones))

    async def all_of_it() -> None:
        worker = WorkerProcess(["onnxruntime"], own)  # which leaves a file
        try:
            await worker.warm()
        finally:
            await worker.close()

    run(all_of_it())
    assert list(everyones.iterdir()) == []  # where it is, if it left any, is in `own`
