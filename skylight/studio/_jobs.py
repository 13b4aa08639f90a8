"""Jobs: a queue of tasks for a worker process, whose files are kept within a limit of size.

:class:`WorkerProcess` runs tasks in order and can be stopped, :class:`Kept` holds items with files
(uploads and jobs) until the oldest are forgotten, and :class:`Jobs` is the queue: each job tells
its progress as events, and is cancelled when no page watches it any more.
"""

import asyncio
import json
import os
import secrets
import shutil
import signal
import sys
import traceback
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from starlette.responses import FileResponse
from starlette.types import Receive, Scope, Send

from skylight.studio._guard import Refused
from skylight.work._progress import StageProgress

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
    """Runs tasks of :mod:`skylight.studio.tasks._worker`, in a process that is started when needed.

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
                "skylight.studio.tasks._worker",
                *self._modules,  # for people who list processes
                env={**os.environ, **dict.fromkeys(_TEMPORARY, self._temporary)},
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                limit=_LINE_BYTES,
                start_new_session=True,  # Ctrl-C is for the server, and stop() ends helpers too
            )
        return self._process


_TOKEN_BYTES = 16


@dataclass(kw_only=True)
class Item:
    """Something with an id that nobody can guess, and a folder that is its own."""

    id: str = field(default_factory=lambda: secrets.token_urlsafe(_TOKEN_BYTES))
    folder: Path
    readers: int = 0

    @property
    def bytes(self) -> int:
        """What its files take on the disk."""
        total = 0
        for file in self.folder.rglob("*"):
            with suppress(OSError):  # a job may just be writing there
                total += file.stat().st_size
        return total


AnyItem = TypeVar("AnyItem", bound=Item)


class Kept(Generic[AnyItem]):
    """Items by id, the oldest first."""

    def __init__(self, folder: Path, what: str, *, most: int, most_bytes: int) -> None:
        folder.mkdir()
        self._folder, self._what = folder, what
        self._most, self._most_bytes = most, most_bytes
        self._items: dict[str, AnyItem] = {}

    def __iter__(self) -> Iterator[AnyItem]:
        return iter(list(self._items.values()))

    def new_folder(self) -> Path:
        """A new empty folder for one item."""
        path = self._folder / secrets.token_hex(_TOKEN_BYTES)
        path.mkdir()
        return path

    def add(self, item: AnyItem) -> None:
        self._items[item.id] = item

    def get(self, token: str) -> AnyItem:
        """The item of that id, or 404."""
        if token not in self._items:
            raise Refused(404, f"there is no such {self._what} (any more); begin again")
        return self._items[token]

    def forget(self, item: AnyItem) -> None:
        """With its files; these as soon as nobody is :meth:`reading` them."""
        self._items.pop(item.id, None)
        if item.readers == 0:
            self.remove(item.folder)

    @contextmanager
    def reading(self, item: AnyItem) -> Iterator[None]:
        """Meanwhile its files stay, also where it is forgotten."""
        item.readers += 1
        try:
            yield
        finally:
            item.readers -= 1
            if item.readers == 0 and item.id not in self._items:
                self.remove(item.folder)

    def remove(self, folder: Path) -> None:
        """A folder that :meth:`new_folder` made."""
        shutil.rmtree(folder, ignore_errors=True)

    def make_room(self, is_used: Callable[[AnyItem], bool]) -> None:
        """Forget the oldest items that are not in use until the rest is few and small enough."""
        sizes = {item.id: item.bytes for item in self}
        count, total = len(sizes), sum(sizes.values())
        for item in self:
            if count <= self._most and total <= self._most_bytes:
                return
            if not is_used(item):
                self.forget(item)
                count, total = count - 1, total - sizes[item.id]


class KeptFile(FileResponse):
    """A file of an item as an answer: it goes out whole, also where the item is forgotten."""

    def __init__(self, kept: Kept[AnyItem], item: AnyItem, path: Path, **options: Any) -> None:
        super().__init__(path, **options)
        self._reading = partial(kept.reading, item)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._reading():
            await super().__call__(scope, receive, send)


State = Literal["waiting", "running", "done", "failed", "cancelled"]
GONE_S = 5.0  # how long a page may be away before its job is cancelled
UNHEARD_S = 60.0  # how long a job runs of which no page has opened the events, nor asks otherwise
HEARTBEAT_S = 15.0  # between events where nothing changes
_FILES = "files"


@dataclass(kw_only=True)
class Job(Item):
    """One piece of work; ``uses`` are the ids of the uploads and jobs whose files it reads.

    While it waits, ``before`` is how many others are done before it, with the one that runs.
    """

    kind: str
    arguments: dict[str, Any]
    uses: tuple[str, ...] = ()
    state: State = "waiting"
    stage: str = ""
    share: float = 0.0
    before: int = 0
    error: str | None = None
    result: dict[str, Any] | None = None
    watchers: int = 0
    was_watched: bool = False
    farewell: asyncio.TimerHandle | None = None
    changed: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def is_over(self) -> bool:
        return self.state in ("done", "failed", "cancelled")

    @property
    def files(self) -> dict[str, Path]:
        """Its results by name, once it is done."""
        if self.state != "done":
            return {}
        return {file.name: file for file in sorted((self.folder / _FILES).iterdir())}

    def describe(self) -> dict[str, Any]:
        """What clients are told."""
        description: dict[str, Any] = {
            "job": self.id,
            "kind": self.kind,
            "state": self.state,
            "stage": self.stage,
            "share": self.share,
        }
        if self.state == "waiting":
            description["before"] = self.before
        if self.error is not None:
            description["error"] = self.error
        if self.state == "done":
            description["result"] = self.result
            description["files"] = [
                {"name": name, "size": file.stat().st_size} for name, file in self.files.items()
            ]
        return description

    def tell(self, stage: str, share: float) -> None:
        """Progress; not heard any more once it was cancelled."""
        if self.state == "running":
            self.update(stage=stage, share=share)

    def update(self, **values: Any) -> None:
        """Set these and wake all who watch."""
        for name, value in values.items():
            setattr(self, name, value)
        self.changed.set()
        self.changed = asyncio.Event()


class Jobs:
    """The queue and what became of it."""

    def __init__(self, kept: Kept[Job], worker: WorkerProcess, *, most: int) -> None:
        self.kept, self._worker, self._most = kept, worker, most
        self._queue: asyncio.Queue[Job] = asyncio.Queue()

    def add(self, kind: str, arguments: dict[str, Any], uses: tuple[str, ...]) -> Job:
        """A job that waits; 429 where too many do. It gets its ``folder`` among the arguments."""
        waiting = sum(not job.is_over for job in self.kept)
        if waiting >= self._most:
            raise Refused(
                429, f"{waiting} jobs are waiting or running already; let one end, or cancel one"
            )
        folder = self.kept.new_folder()
        (folder / _FILES).mkdir()
        arguments = {**arguments, "folder": str(folder / _FILES)}
        job = Job(folder=folder, kind=kind, arguments=arguments, uses=uses)
        self.kept.add(job)
        self.kept.make_room(lambda other: not other.is_over or self.is_used(other))
        self._count()
        self._queue.put_nowait(job)
        self.heard(job)
        return job

    def heard(self, job: Job) -> None:
        """Its owner asked for it: without a stream of events it goes on for :data:`UNHEARD_S`."""
        if not job.was_watched and not job.is_over:
            self._cancel_after(UNHEARD_S, job)

    def is_used(self, item: Item) -> bool:
        """Whether a job that is not over reads its files."""
        return any(item.id in job.uses for job in self.kept if not job.is_over)

    def cancel(self, job: Job) -> None:
        """Stop it; its process goes at once."""
        if job.is_over:
            return
        was_running = job.state == "running"
        job.update(state="cancelled")
        self._count()
        if was_running:
            self._worker.stop()

    def forget(self, job: Job) -> None:
        """A finished job with its files; 409 where another one reads them now."""
        if self.is_used(job):
            raise Refused(409, "another job uses the results of this one; wait for it to end")
        self.kept.forget(job)

    async def work(self) -> None:
        """Do the jobs, for ever."""
        await self._worker.warm()
        while True:
            job = await self._queue.get()
            if job.state == "waiting":
                job.update(state="running")
                await self._do(job)

    async def _do(self, job: Job) -> None:
        try:
            result = await self._worker.run(job.kind, job.arguments, job.tell)
        except TaskFailed as error:
            outcome: dict[str, Any] = {"state": "failed", "error": str(error)}
        except TaskStopped:
            line = "the process that worked on it died, perhaps for want of memory; try again"
            outcome = {"state": "failed", "error": line}
            await self._worker.warm()
        except Exception as error:  # one job that fails in an unknown way must not end them all
            traceback.print_exc()
            line = f"internal error ({type(error).__name__}); the server's terminal tells more"
            outcome = {"state": "failed", "error": line}
            self._worker.stop()
        else:
            outcome = {"state": "done", "share": 1.0, "result": result}
        if job.state == "running":
            job.update(**outcome)
            self._count()

    def _count(self) -> None:
        """Tell those that wait how many are before them."""
        others = [job for job in self.kept if not job.is_over]  # the oldest first, as in the queue
        for before, job in enumerate(others):
            if job.state == "waiting" and job.before != before:
                job.update(before=before)

    def _cancel_after(self, seconds: float, job: Job) -> None:
        if job.farewell is not None:
            job.farewell.cancel()
        job.farewell = asyncio.get_running_loop().call_later(seconds, self.cancel, job)

    @contextmanager
    def watching(self, job: Job) -> Iterator[None]:
        """A page listens; :data:`GONE_S` after the last has gone the job is cancelled."""
        job.watchers, job.was_watched = job.watchers + 1, True
        if job.farewell is not None:
            job.farewell.cancel()
        try:
            yield
        finally:
            job.watchers -= 1
            if not job.is_over and job.watchers == 0:
                self._cancel_after(GONE_S, job)


async def events(job: Job) -> AsyncIterator[dict[str, Any]]:
    """Its description whenever it changes and every :data:`HEARTBEAT_S`, to the end."""
    while True:
        changed = job.changed
        yield job.describe()
        if job.is_over:
            return
        with suppress(TimeoutError):
            await asyncio.wait_for(changed.wait(), HEARTBEAT_S)
