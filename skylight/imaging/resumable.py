"""Long work in several processes, on folders that a later run goes on with."""

import json
import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import TypeVar

import torch

from skylight.errors import InputError
from skylight.imaging.files import write_json

Result = TypeVar("Result")


def settle(note: Path, settings: dict[str, object]) -> None:
    """Note what a folder is made with, or see that an earlier run made it with the same.

    Raises
    ------
    InputError
        The note is damaged or tells of other settings; the line names both.
    """
    wanted = json.loads(json.dumps(settings))
    if note.exists():
        try:
            there = json.loads(note.read_text(encoding="utf-8"))
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
    arguments: Iterable[tuple],
    *,
    workers: int,
    prepare: Callable[[], None] | None = None,
    finish: bool = False,
) -> Iterator[Result]:
    """Results of ``work(*one)`` for each of ``arguments``, as they come.

    With one worker or one piece of work in this process; otherwise each process runs ``prepare``
    first and computes with one thread. Ctrl-C ends the pieces at work; with ``finish``, for pieces
    of seconds that leave files, they and those already handed out are finished.
    """
    pieces = list(arguments)
    if workers == 1 or len(pieces) < 2:
        for one in pieces:
            yield work(*one)
        return
    # spawned, because a process that has run torch's threads cannot be forked safely
    pool = ProcessPoolExecutor(
        min(workers, len(pieces)),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_start_worker,
        initargs=(prepare, finish),
    )
    try:
        futures = [pool.submit(work, *one) for one in pieces]
        for future in as_completed(futures):
            yield future.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _start_worker(prepare: Callable[[], None] | None, finish: bool) -> None:
    torch.set_num_threads(1)  # the workers already share the cores
    if prepare is not None:
        prepare()
    if finish:  # Ctrl-C reaches workers too; here the parent decides
        signal.signal(signal.SIGINT, signal.SIG_IGN)
