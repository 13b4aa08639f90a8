"""Folders of results, replaced as a whole when a run succeeds."""

import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from skylight.errors import OutputError
from skylight.io.atomic import PARTIAL


@contextmanager
def results_folder(out: Path, replaced: re.Pattern[str] | None = None) -> Iterator[Path]:
    """A temporary folder in ``out``; its files move to ``out`` when the block ends well.

    Made before the work starts, so that a folder that cannot be written to is found at once.
    Whatever ends the block early, files of an earlier run stay as they were; when it ends well,
    those whose whole name matches ``replaced`` go, whether or not there are new ones.
    """
    is_new = not out.exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
        # within, not beside: ``out`` may be writable, or another disk, where its parent is not
        partial = Path(tempfile.mkdtemp(prefix=PARTIAL, dir=out))
    except OSError as error:
        raise OutputError(
            f"cannot write into {out}: {error.strerror}; choose another folder with --out"
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
