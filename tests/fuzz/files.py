"""Where the fuzzed content lies while it is read, and seeds that are files or folders."""

import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from skylight.errors import InputError, SkylightError

_FOLDER = tempfile.TemporaryDirectory(prefix="skylight-fuzz-")
PLACE = Path(_FOLDER.name)
_MARK = b"--member--"


def as_file(content: bytes, name: str) -> Path:
    """``content`` in a file of that name, in place of the one before."""
    path = PLACE / name
    path.write_bytes(content)
    return path


def clear(error: Exception) -> str:
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


def joined(members: Mapping[str, bytes]) -> bytes:
    """Several files in one content, which mutates more freely than a ZIP file does."""
    return b"".join(_MARK + name.encode() + b"\0" + data for name, data in members.items())


def parted(content: bytes) -> dict[str, bytes]:
    """The files of :func:`joined` after mutation; of two of one name the first."""
    members: dict[str, bytes] = {}
    for member in content.split(_MARK)[1:]:
        name, _, data = member.partition(b"\0")
        members.setdefault(name.decode("latin-1"), data)
    return members


def is_refused(read: Callable[[], object]) -> bool:
    """Whether ``read`` ends in one clear line, where there is more to read."""
    try:
        read()
    except SkylightError as error:
        clear(error)
        return True
    return False


def read_by_any(readers: Iterable[Callable[[], object]]) -> None:
    """Have all readers read; InputError where every one of them refuses."""
    refused = [is_refused(reader) for reader in readers]
    if all(refused):
        raise InputError("refused by all")
