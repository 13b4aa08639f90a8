"""Folders of rendered faces, rendered in parallel and resumable."""

import os
import shutil
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

from skylight.errors import OutputError
from skylight.io._atomic import PARTIAL
from skylight.people._files import folder_name, write_rendered_face
from skylight.people._independent_render import mitsuba_variant
from skylight.people._light import RenderOptions
from skylight.people._render import render
from skylight.work._progress import CountProgress
from skylight.work._resumable import Workers, claimed, settle, share_work


def render_folder(
    out: Path,
    count: int,
    options: RenderOptions,
    *,
    workers: Workers = 1,
    progress: CountProgress | None = None,
) -> int:
    """Render faces 0 to ``count`` - 1 into ``out`` and say how many were made now.

    A face's folder appears when all of it is there, so those that exist are passed over.

    Raises
    ------
    InputError
        ``out`` holds faces made with other options, another run is at work there, or Mitsuba is
        not installed.
    OutputError
        A folder that cannot be written to.
    """
    mitsuba_variant()  # refuses at once where it is not installed
    with claimed(out):
        settle(out / "options.json", options.settings())
        missing = [n for n in range(count) if not (out / folder_name(n)).exists()]
        done = count - len(missing)
        if progress:
            progress(done, count)
        work = [(out, number, options) for number in missing]
        for _ in share_work(render_to, work, workers=workers, prepare=_prepare, finish=True):
            done += 1
            if progress:
                progress(done, count)
    return len(missing)


def render_to(out: Path, number: int, options: RenderOptions) -> None:
    """Render one face into its folder, which appears whole or not at all.

    A folder that another process has made meanwhile, which was taken for lost, is left as it is.
    """
    place, partial = out / folder_name(number), out / f"{PARTIAL}{uuid4().hex[:12]}"
    try:
        partial.mkdir()
        write_rendered_face(partial, render(number, options), options)
        try:
            os.replace(partial, place)
        except OSError:
            if not place.is_dir():
                raise
    except OSError as error:
        raise OutputError(f"cannot write {place}: {error.strerror}") from error
    finally:
        with suppress(OSError):
            shutil.rmtree(partial)


def _prepare() -> None:
    mitsuba_variant()
    import drjit

    drjit.set_thread_count(1)  # the processes already share the cores
