"""Where the fuzzed content lies while it is read, and seeds that are files."""

import tempfile
from collections.abc import Callable
from pathlib import Path

from skylight.errors import SkylightError

_FOLDER = tempfile.TemporaryDirectory(prefix="skylight-fuzz-")
PLACE = Path(_FOLDER.name)


def as_file(content: bytes, name: str) -> Path:
    """``content`` in a file of that name, in place of the one before."""
    path = PLACE / name
    path.write_bytes(content)
    return path


def clear(error: SkylightError) -> str:
    """The message of a refusal, which is one line."""
    line = str(error)
    assert line
    assert "\n" not in line, line
    return line


def written(name: str, write: Callable[[Path], object]) -> bytes:
    """What ``write`` writes into a file of that name."""
    path = PLACE / name
    write(path)
    return path.read_bytes()
