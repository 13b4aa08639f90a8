"""The queue of jobs in a worker process, with events, cancelled when no page watches."""

import asyncio
import traceback
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from skylight.studio.kept import Item, Kept
from skylight.studio.refusals import Refused
from skylight.studio.worker_process import TaskFailed, TaskStopped, WorkerProcess

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
        told: dict[str, Any] = {
            "job": self.id,
            "kind": self.kind,
            "state": self.state,
            "stage": self.stage,
            "share": self.share,
        }
        if self.state == "waiting":
            told["before"] = self.before
        if self.error is not None:
            told["error"] = self.error
        if self.state == "done":
            told["result"] = self.result
            told["files"] = [
                {"name": name, "size": file.stat().st_size} for name, file in self.files.items()
            ]
        return told

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
