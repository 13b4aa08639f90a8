"""The handle of a worker process: tasks in order, and cancellation."""

import asyncio
import json
import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from skylight.work.progress import StageProgress

_LINE_BYTES = 64_000_000  # the longest answer
_WARM = "warm"
_TEMPORARY = ("TMPDIR", "TEMP", "TMP")  # that Python and others look at


class TaskFailed(Exception):
    """``str(error)`` is one line for the user; ``is_input`` where what they gave is at fault."""

    def __init__(self, message: str, *, is_input: bool) -> None:
        super().__init__(" ".join(message.split()))
        self.is_input = is_input


class TaskStopped(Exception):
    """The process ended within the task: it was stopped, or it crashed."""


class WorkerProcess:
    """Runs tasks of :mod:`skylight.studio.tasks.worker`, in a process that is started when needed.

    ``modules`` are imported as soon as it starts, so that the first task need not wait for them.
    What its libraries leave behind, or a task that is stopped, is in the folder ``temporary``.
    """

    def __init__(self, modules: list[str], temporary: Path) -> None:
        self._modules, self._temporary = modules, str(temporary)
        self._process: asyncio.subprocess.Process | None = None
        self._is_stopped = self._is_closed = False
        self._turn = asyncio.Lock()

    async def warm(self) -> None:
        """Start the process where there is none, and import its modules."""
        # a process that cannot be started now is what the next task will tell of
        with suppress(TaskFailed, TaskStopped, OSError):
            await self.run(_WARM, {"modules": self._modules})

    async def run(
        self, task: str, arguments: dict[str, Any], tell: StageProgress | None = None
    ) -> dict[str, Any]:
        """The task's result, once it is its turn.

        Raises
        ------
        TaskFailed
            It could not be done, and why.
        TaskStopped
            :meth:`stop` or :meth:`close` was called, or the process died.
        """
        async with self._turn:
            process = await self._started()
            if self._is_stopped:  # while it started
                await self._ended()
                raise TaskStopped
            assert process.stdin is not None
            assert process.stdout is not None
            line = json.dumps({"task": task, "arguments": arguments}) + "\n"
            try:
                process.stdin.write(line.encode())
                await process.stdin.drain()
                while line := await process.stdout.readline():
                    message = json.loads(line)
                    if "result" in message:
                        return message["result"]
                    if "error" in message:
                        raise TaskFailed(message["error"], is_input=message["fault"] == "input")
                    if tell is not None:
                        tell(message["stage"], message["share"])
            except ConnectionError:
                pass
            except (asyncio.CancelledError, ValueError):  # the latter: an answer beyond the limit
                self.stop()  # else what is left of it would be taken for that of the next task
                raise
            await process.wait()
            raise TaskStopped

    def stop(self) -> None:
        """End the process and all that it started, now; the next task starts another."""
        process, self._is_stopped = self._process, True
        if process is not None and process.returncode is None:
            with suppress(ProcessLookupError):
                if hasattr(os, "killpg"):
                    os.killpg(process.pid, signal.SIGKILL)
                else:
                    process.kill()

    async def close(self) -> None:
        """:meth:`stop`, wait until it is gone, and start no other."""
        self._is_closed = True
        await self._ended()

    async def _ended(self) -> None:
        self.stop()
        await self._gone()

    async def _gone(self) -> None:
        if self._process is not None:
            await self._process.wait()

    async def _started(self) -> asyncio.subprocess.Process:
        if self._is_closed:
            raise TaskStopped
        if self._is_stopped:
            self._is_stopped = False  # first: it may be stopped again while the old one ends
            await self._gone()
        if self._process is None or self._process.returncode is not None:
            self._process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-P",  # modules in the folder where the user happens to be are not ours
                "-m",
                "skylight.studio.tasks.worker",
                *self._modules,  # for people who list processes
                env={**os.environ, **dict.fromkeys(_TEMPORARY, self._temporary)},
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                limit=_LINE_BYTES,
                start_new_session=True,  # Ctrl-C is for the server, and stop() ends helpers too
            )
        return self._process
