"""Atomic writes: files beside their place, then renamed; without torch."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

from skylight.errors import OutputError

PARTIAL = ".partial-"  # begins the names of files and folders that are not whole yet
_MEND = {
    errno.ENOENT: "make the folder first",
    errno.ENOSPC: "free some space or choose another disk",
    errno.EDQUOT: "free some space or choose another disk",
    errno.EACCES: "choose a folder that you may write to",
    errno.EPERM: "choose a folder that you may write to",
    errno.EROFS: "choose a folder that you may write to",
}


def require_place(path: str | Path) -> None:
    """Refuse, before any work, a file in a folder that is not there, or that is a folder itself.

    Raises
    ------
    OutputError
        :func:`atomic_path` could not write there.
    """
    path = Path(path)
    _require_file(path)
    if not path.resolve().parent.is_dir():
        raise OutputError(f"cannot write {path}: no such folder; {_MEND[errno.ENOENT]}")


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """A temporary file beside ``path`` that takes its place when the block ends well.

    Whatever ends the block early (an exception, Ctrl-C, a full disk), the temporary file is
    removed and what stood at ``path`` is untouched. An :class:`OSError` in the block becomes an
    :class:`OutputError` about ``path``, so do nothing but write in it.
    """
    path = Path(path)
    _require_file(path)
    target = path.resolve()  # replace the file that a link points to, not the link
    temporary = target.with_name(f"{PARTIAL}{uuid4().hex[:12]}{path.suffix}")
    try:
        temporary.touch(exist_ok=False)
        yield temporary
        with open(temporary, "rb+") as file:  # a late "no space" must come before the rename
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except OSError as error:
        mend = f"; {_MEND[error.errno]}" if error.errno in _MEND else ""
        reason = error.strerror or str(error)
        raise OutputError(f"cannot write {path}: {reason}{mend}") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _require_file(path: Path) -> None:
    if path.exists() and not path.is_file():
        raise OutputError(f"cannot write {path}: it is no ordinary file; choose another name")
