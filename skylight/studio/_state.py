"""The state of a running server: uploads, jobs, processes, and its temporary folder.

The folder is removed at the server's end, or by the next server: each holds a lock on its own,
which the system lets go however the process ends.
"""

import asyncio
import os
import re
import shutil
import tempfile
import time
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from starlette.requests import ClientDisconnect, Request

from skylight._names import DEFAULT_LIGHT, DEFAULT_SKY, LightName
from skylight.models._manifest import places_file
from skylight.studio._guard import Limits, Refused
from skylight.studio._jobs import Item, Job, Jobs, Kept, TaskFailed, TaskStopped, WorkerProcess
from skylight.studio._requests import LampsEdit

HDR = (".exr", ".hdr")
UPLOADS_AT_ONCE = 4
_READING_S = 300.0  # 50 megapixels take some tens of seconds, and wait for their turn
_NAME_MOST = 80
_JOB_MODULES = ["skylight.studio.tasks._light"]
_READER_MODULES = ["skylight.studio.tasks._uploads"]


@dataclass(kw_only=True)
class Upload(Item):
    """A photograph or a map that a page sent; ``name`` is for people, and never a path."""

    name: str
    path: Path
    seen: dict[str, Any]

    @property
    def preview(self) -> Path:
        return preview_of(self.folder)


class Studio:
    """Everything is in ``folder``, which is its own."""

    def __init__(
        self, folder: Path, limits: Limits, *, model: Path | None = None, network: str | None = None
    ) -> None:
        self.limits = limits
        self.model = model  # folder of a trained light model
        self.of_places = model is not None and places_file(model) is not None
        of_skies = model is not None and not self.of_places
        self.light: LightName = DEFAULT_SKY if of_skies else DEFAULT_LIGHT
        self.network = network  # module:Class of its network, where that is the user's

        def kept(name: str, most: int) -> Kept:
            most_bytes = limits.kept_bytes
            return Kept(folder / f"{name}s", name, most=most, most_bytes=most_bytes)

        self.photos: Kept[Upload] = kept("photo", limits.uploads)
        self.maps: Kept[Upload] = kept("map", limits.uploads)
        results: Kept[Job] = kept("job", limits.results)
        (temporary := folder / "temporary").mkdir()
        self._worker = WorkerProcess(_JOB_MODULES, temporary)
        # of its own, so that uploads are answered while a job runs
        self._reader = WorkerProcess(_READER_MODULES, temporary)
        self.jobs = Jobs(results, self._worker, most=limits.jobs)
        self._uploading = 0
        self._asked: dict[str, dict[str, Any]] = {}
        self._tasks: list[asyncio.Task[None]] = []

    def start(self) -> None:
        """Begin to work, in the running event loop."""
        self._tasks = [
            asyncio.create_task(self.jobs.work()),
            asyncio.create_task(self._reader.warm()),
        ]

    async def stop(self) -> None:
        """End all work, and with it the streams of events."""
        for job in self.jobs.kept:
            self.jobs.cancel(job)
        await self._worker.close()
        await self._reader.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def end_processes(self) -> None:
        """Now, whatever they do."""
        self._worker.stop()
        self._reader.stop()

    async def ask(self, question: str) -> dict[str, Any]:
        """The answer of a task without arguments, which is always the same."""
        if question not in self._asked:
            self._asked[question] = await self._read(question, {})
        return self._asked[question]

    async def under_edited_lamps(self, job: Job, file: str, edit: LampsEdit) -> bytes:
        """A file of an estimate that found so many lamps, under these as they are now."""
        arguments = {
            "folder": str(job.folder),
            "file": file,
            **edit.model_dump(exclude={"download"}),
        }
        with self.jobs.kept.reading(job):
            return b64decode((await self._read("lamps", arguments))["content"])

    async def take_photo(self, request: Request, name: str) -> Upload:
        """A photograph from a request's body, with its preview and faces."""
        return await self._take(request, clean_name(name, "photo"), self.photos, "photo")

    async def take_map(self, request: Request, name: str) -> Upload:
        """A map of light from a request's body."""
        name = clean_name(name, "map")
        if Path(name).suffix.lower() not in HDR:
            raise Refused(415, f"{name}: maps of light are .exr or .hdr files; choose one of them")
        return await self._take(request, name, self.maps, "map")

    async def _take(self, request: Request, name: str, kept: Kept[Upload], task: str) -> Upload:
        if self._uploading >= UPLOADS_AT_ONCE:
            raise Refused(429, f"{self._uploading} files are coming in already; try again soon")
        self._uploading += 1
        folder = kept.new_folder()
        try:
            suffix = Path(name).suffix.lower()
            path = folder / f"upload{suffix if suffix in HDR else ''}"
            await _receive(request, path)
            arguments = {"path": str(path), "name": name, "pixels": self.limits.pixels}
            if task == "photo":
                arguments["preview"] = str(preview_of(folder))
            seen = await self._read(task, arguments)
            if await request.is_disconnected():  # nobody learns what it is called
                raise Refused(400, f"{name}: whoever sent it has gone")
        except BaseException:
            kept.remove(folder)
            raise
        finally:
            self._uploading -= 1
        upload = Upload(folder=folder, name=name, path=path, seen=seen)
        kept.add(upload)
        kept.make_room(lambda other: other is upload or self.jobs.is_used(other))
        return upload

    async def _read(self, task: str, arguments: dict[str, Any]) -> dict[str, Any]:
        def refused(of_file: str, of_task: str) -> Refused:
            if "name" in arguments:
                return Refused(422, f"{arguments['name']}: {of_file}")
            return Refused(500, f"{task}: {of_task}")

        try:
            async with asyncio.timeout(_READING_S):
                return await self._reader.run(task, arguments)
        except TaskFailed as error:
            raise Refused(422 if error.is_input else 500, str(error)) from error
        except TaskStopped as error:
            raise refused(
                "the process that read it died; try another file",
                "the process that worked on it died; try again",
            ) from error
        except TimeoutError as error:
            raise refused(
                "reading it took too long; try a smaller file", "it took too long; try again"
            ) from error


async def _receive(request: Request, path: Path) -> None:
    total = 0
    with path.open("wb") as file, suppress(ClientDisconnect):
        async for chunk in request.stream():
            file.write(chunk)
            total += len(chunk)
        if total:
            return
    raise Refused(400, "nothing came in; send the file as the request's body")


def preview_of(folder: Path) -> Path:
    """Where the preview of the photograph in that folder is."""
    return folder / "preview.jpg"


def clean_name(name: str, otherwise: str) -> str:
    """A file's name as a browser tells it, without folders, controls or great length."""
    last = re.split(r"[/\\]", name)[-1]
    printable = "".join(letter for letter in last if letter.isprintable()).strip()
    stem, suffix = Path(printable).stem, Path(printable).suffix
    return (stem[: _NAME_MOST - len(suffix[:8])] + suffix[:8]) or otherwise


try:
    import fcntl
except ImportError:  # Windows: nothing tells which folders are abandoned, so they stay
    fcntl = None

PREFIX = "skylight-studio-"
_YOUNG_S = 60.0  # a server that is starting has not locked its folder yet


@contextmanager
def own_folder() -> Iterator[Path]:
    """A new folder that is removed at the end; this user's abandoned ones are removed first."""
    _remove_abandoned()
    with tempfile.TemporaryDirectory(prefix=PREFIX) as folder:
        if fcntl is None:
            yield Path(folder)
            return
        lock = os.open(folder, os.O_RDONLY)
        try:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield Path(folder)
        finally:
            os.close(lock)


def _remove_abandoned() -> None:
    if fcntl is None:
        return
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with suppress(OSError):  # another's, gone by now, or locked by its server
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                status = os.fstat(lock)
                if status.st_uid == os.getuid() and time.time() - status.st_mtime > _YOUNG_S:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(folder)
            finally:
                os.close(lock)
