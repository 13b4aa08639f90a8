"""Work that may be interrupted: folders that keep what is done, and processes that share the rest.

A folder is locked by one run at a time, notes the settings that it is made with, or is replaced
as a whole when a run succeeds. A piece of work whose process dies is given to another one.
"""

import json
import multiprocessing
import os
import re
import shutil
import signal
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from typing import IO, Any, TypeVar

from skylight.errors import InputError, OutputError, SkylightError
from skylight.io._atomic import PARTIAL
from skylight.io._bounded import json_content, write_json
from skylight.work._cluster import Cluster, share_on_cluster
from skylight.work._memory import collect_seldom
from skylight.work._processes import run_piece
from skylight.work._threads import ONE_THREAD

SETTINGS = "settings.json"  # the note of :func:`keep_settings`
Result = TypeVar("Result")
Workers = int | Cluster  # so many processes here, or those of a cluster
MOST_LOSSES = 3  # a piece that its process did not survive so often is given up


@contextmanager
def locked(folder: Path, *inner: Path) -> Iterator[None]:
    """A folder for one run at a time, made where there is none; it and ``inner`` are swept.

    The lock ends with its process. Windows, and some clusters' file systems, have no such locks:
    there runs are not kept apart, and nothing is swept.
    """
    try:
        _require_folder(folder)
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / ".lock").open("w")
    except OSError as error:
        raise OutputError(
            f"cannot write into {folder}: {error.strerror}; choose another folder for the results"
        ) from error
    with lock:
        is_locked = _is_locked(lock, folder)
        if is_locked:
            _sweep(folder, *inner)
        yield
        if is_locked:  # workers may have been killed meanwhile
            _sweep(folder, *inner)


def _sweep(*folders: Path) -> None:
    """Remove what processes that were killed have left half written."""
    for folder in folders:
        for partial in folder.glob(f"{PARTIAL}*"):
            if partial.is_dir():
                shutil.rmtree(partial, ignore_errors=True)
            else:
                partial.unlink(missing_ok=True)


def _is_locked(file: IO[str], folder: Path) -> bool:
    """Whether this run has the lock now; False where there are no locks."""
    try:
        import fcntl
    except ImportError:  # Windows
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InputError(
            f"{folder}: another run is at work there; wait for it, or give another folder"
        ) from error
    except OSError:  # a file system without locks, as some clusters have
        return False
    return True


def keep_settings(note: Path, settings: dict[str, object]) -> None:
    """Note what a folder is made with, or see that an earlier run made it with the same."""
    wanted = json.loads(json.dumps(settings))
    if note.exists():
        try:
            there = json_content(note)
        except ValueError as error:
            raise InputError(f"{note}: damaged; give another folder ({error})") from error
        if there != wanted:
            raise InputError(
                f"{note.parent}: made with other settings ({json.dumps(there)}, now "
                f"{json.dumps(wanted)}); give the same, or another folder"
            )
    write_json(note, wanted)


def share_work(
    work: Callable[..., Result],
    arguments: Iterable[tuple[Any, ...]],
    *,
    workers: Workers,
    prepare: Callable[[], None] | None = None,
    finish: bool | Callable[..., bool] = False,
    lost: Callable[..., Result] | None = None,
) -> Generator[Result, None, None]:
    """Results of ``work(*one)`` for each of ``arguments``, as they come.

    With one worker or one piece of work in this process; otherwise each process runs ``prepare``
    first and computes with one thread. Ctrl-C ends the pieces at work; with ``finish``, for pieces
    of seconds, those at work here are finished, and their results come before the interrupt; where
    it is a function, those of which ``finish(*one)`` is true.

    Whoever takes the results may add to ``arguments`` where that is a deque, of which pieces are
    taken from the left (not on a cluster).

    A piece whose process dies (killed, or out of memory) is given to another process. One that
    has lost three is answered by ``lost(*one)``; with ``lost``, even a single worker is another
    process, which this one survives.

    Raises
    ------
    SkylightError
        A piece lost its process three times, and there is no ``lost``.
    """
    pieces = arguments if isinstance(arguments, deque) else deque(arguments)
    if isinstance(workers, Cluster):
        yield from share_on_cluster(work, list(pieces), workers, prepare=prepare, lost=lost)
    elif lost is None and (workers == 1 or len(pieces) < 2):
        while pieces:
            yield work(*pieces.popleft())
    else:
        yield from _share_here(work, pieces, workers, prepare, finish, lost)


def _share_here(
    work: Callable[..., Result],
    pieces: deque[tuple],
    workers: int,
    prepare: Callable[[], None] | None,
    finish: bool | Callable[..., bool],
    lost: Callable[..., Result] | None,
) -> Iterator[Result]:
    again: list[tuple[tuple, int]] = []  # pieces and how many processes these have lost
    # a pool for each process: where one dies, it is known at which piece
    idle: list[ProcessPoolExecutor] = []
    busy: dict[Future[Result], tuple[ProcessPoolExecutor, tuple, int]] = {}
    try:
        while again or pieces or busy:
            while (again or pieces) and len(busy) < workers:
                pool = idle.pop() if idle else _process(bool(finish))
                one, losses = again.pop() if again else (pieces.popleft(), 0)
                with _for_new_processes():
                    try:
                        busy[pool.submit(run_piece, prepare, work, one)] = pool, one, losses
                    except BrokenProcessPool:  # killed while idle
                        again.append((one, losses))
            for future in wait(busy, return_when=FIRST_COMPLETED).done:
                pool, one, losses = busy.pop(future)
                try:
                    result = future.result()
                except BrokenProcessPool as error:
                    pool.shutdown()
                    if losses + 1 < MOST_LOSSES:
                        again.append((one, losses + 1))
                        continue
                    if lost is None:
                        raise SkylightError(
                            f"a process died {MOST_LOSSES} times at the same piece of work, so "
                            "memory may be short; what is done is kept: use fewer workers, and "
                            "run the same command again"
                        ) from error
                    result = lost(*one)
                else:
                    idle.append(pool)
                yield result
    except KeyboardInterrupt:
        if finish:
            wanted = [f for f, (_, one, _) in busy.items() if finish is True or finish(*one)]
            for future in as_completed(wanted):
                with suppress(BrokenProcessPool):  # the next run's piece
                    yield future.result()
        raise
    finally:
        for pool in (*idle, *(pool for pool, _, _ in busy.values())):
            pool.shutdown(cancel_futures=True)


def _process(finish: bool) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(
        1,
        # spawned, because a process that has run torch's threads cannot be forked safely
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_start_worker,
        initargs=(finish,),
    )


@contextmanager
def _for_new_processes() -> Iterator[None]:
    """Processes that start within have one thread, and do not hear Ctrl-C while they start.

    The environment is what all libraries read when they are loaded.
    """
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    can_mask = hasattr(signal, "pthread_sigmask")  # not on Windows
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if can_mask else None
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _start_worker(finish: bool) -> None:
    collect_seldom()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if finish:  # Ctrl-C reaches workers too; here the parent decides
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    elif hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _end_with_parent() -> None:
    """A parent that was killed cannot end its workers, and they would wait for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for([parent.sentinel])
        os._exit(1)


def _require_folder(out: Path) -> None:
    if out.exists() and not out.is_dir():
        raise OutputError(f"cannot write into {out}: it is a file; give a folder")


@contextmanager
def results_folder(out: Path, replaced: re.Pattern[str] | None = None) -> Iterator[Path]:
    """A temporary folder in ``out``; its files move to ``out`` when the block ends well.

    Made before the work starts, so that a folder that cannot be written to is found at once.
    Whatever ends the block early, files of an earlier run stay as they were; when it ends well,
    those whose whole name matches ``replaced`` go, whether or not there are new ones.
    """
    is_new = not out.exists()
    try:
        _require_folder(out)
        out.mkdir(parents=True, exist_ok=True)
        # within, not beside: ``out`` may be writable, or another disk, where its parent is not
        partial = Path(tempfile.mkdtemp(prefix=PARTIAL, dir=out))
    except OSError as error:
        raise OutputError(
            f"cannot write into {out}: {error.strerror}; choose another folder for the results"
        ) from error
    try:
        yield partial
        made = sorted(partial.iterdir())
        for file in made:
            if (out / file.name).is_dir():
                raise OutputError(f"cannot write {out / file.name}: a folder has that name")
        for file in made:
            os.replace(file, out / file.name)
        names = {file.name for file in made}
        if replaced is not None:
            for file in sorted(out.iterdir()):
                if file.is_file() and replaced.fullmatch(file.name) and file.name not in names:
                    file.unlink()
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        if is_new:
            with suppress(OSError):  # not empty: the run went well
                out.rmdir()
