"""Folders of rendered faces, in several processes; what is there is kept."""

import json
import multiprocessing
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from uuid import uuid4

import torch

from skylight.errors import InputError, OutputError
from skylight.evaluation.independent_render import mitsuba_variant
from skylight.evaluation.rendered_faces.files import folder_name, write_rendered_face
from skylight.evaluation.rendered_faces.options import RenderOptions
from skylight.evaluation.rendered_faces.render import render
from skylight.imaging.files import write_json


def render_folder(
    out: Path,
    count: int,
    options: RenderOptions,
    *,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Render faces 0 to ``count`` - 1 into ``out`` and say how many were made now.

    A face's folder appears when all of it is there, so those that exist are passed over.

    Raises
    ------
    InputError
        ``out`` holds faces made with other options, or Mitsuba is not installed.
    OutputError
        A folder that cannot be written to.
    """
    mitsuba_variant()  # refuses at once where it is not installed
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write into {out}: {error.strerror}") from error
    _settle(out / "options.json", options)
    missing = [n for n in range(count) if not (out / folder_name(n)).exists()]
    done = count - len(missing)
    if progress:
        progress(done, count)
    for _ in _render_all(out, missing, options, workers):
        done += 1
        if progress:
            progress(done, count)
    return len(missing)


def render_to(out: Path, number: int, options: RenderOptions) -> int:
    """Render one face into its folder, which appears whole or not at all."""
    partial = out / f".partial-{uuid4().hex[:12]}"
    try:
        partial.mkdir()
        write_rendered_face(partial, render(number, options), options)
        os.replace(partial, out / folder_name(number))
    except OSError as error:
        raise OutputError(f"cannot write {out / folder_name(number)}: {error.strerror}") from error
    finally:
        with suppress(OSError):
            shutil.rmtree(partial)
    return number


def _settle(note: Path, options: RenderOptions) -> None:
    """Write the options, or see that those of an earlier run were the same."""
    if note.exists():
        try:
            there = json.loads(note.read_text(encoding="utf-8"))
        except ValueError as error:
            raise InputError(f"{note}: damaged; give another folder ({error})") from error
        if there != asdict(options):
            raise InputError(
                f"{note.parent}: holds faces rendered with {there}; give the same options, or "
                "another folder"
            )
    write_json(note, asdict(options))


def _render_all(
    out: Path, numbers: list[int], options: RenderOptions, workers: int
) -> Iterator[int]:
    if workers == 1 or len(numbers) < 2:
        for number in numbers:
            yield render_to(out, number, options)
        return
    # spawned, because a process that has run torch's threads cannot be forked safely
    pool = ProcessPoolExecutor(
        min(workers, len(numbers)),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_start_worker,
    )
    try:
        futures = [pool.submit(render_to, out, number, options) for number in numbers]
        for future in as_completed(futures):
            yield future.result()
    finally:
        # on Ctrl-C the faces at work are finished, which takes seconds, and no others begun
        pool.shutdown(cancel_futures=True)


def _start_worker() -> None:
    """One thread each: the processes already share the cores."""
    torch.set_num_threads(1)
    mitsuba_variant()
    import drjit

    drjit.set_thread_count(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches them too; the parent decides
