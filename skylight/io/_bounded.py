"""Untrusted files (bytes, text, JSON, NumPy arrays) read within limits, and JSON written.

Limits are checked before memory is allocated. Without torch, which relighting must not import.
What cannot be used is an :class:`OSError` (it cannot be opened) or a :class:`ValueError` (it is not
what it should be); readers make of either an :class:`~skylight.errors.InputError` that names the
file and says what to do.
"""

import errno
import json
import math
import os
import re
import stat
import sys
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from skylight.errors import InputError
from skylight.io._atomic import atomic_path

PIXELS_MAX = 2**27  # of a picture: 16384 x 8192
PICTURE_BYTES_MAX = 2**31  # decoded: four float32 channels of as many pixels
FILE_BYTES_MAX = 2**30
ARRAY_BYTES_MAX = 2**31  # of all arrays of a file together, decompressed
TEXT_BYTES_MAX = 2**26

_NO_CHARACTER = "its text holds what is no character"
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")

_BAD_ZIP = (
    zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, KeyError,
)  # fmt: skip


def file_bytes(path: Path, *, most: int = FILE_BYTES_MAX) -> bytes:
    """The content of an ordinary file of at most ``most`` bytes.

    Raises
    ------
    OSError
        It cannot be opened, or is a device or pipe, which may never end.
    ValueError
        It is larger.
    """
    require_bytes(path, most)
    with path.open("rb") as stream:
        return stream.read(most)


def require_bytes(path: Path, most: int | None = FILE_BYTES_MAX) -> int:
    """The size of an ordinary file; raises as :func:`file_bytes`."""
    status = path.stat()
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is a device or a pipe, not a file", str(path))
    if most is not None and status.st_size > most:
        raise ValueError(f"{status.st_size} bytes are more than the {most} that are read")
    return status.st_size


def file_text(path: Path, *, encoding: str = "utf-8", most: int = TEXT_BYTES_MAX) -> str:
    """The text of a file, its line ends as they are; raises as :func:`file_bytes`."""
    return file_bytes(path, most=most).decode(encoding)


def json_content(path: Path, *, most: int = TEXT_BYTES_MAX) -> Any:
    """What a JSON file holds; raises as :func:`file_bytes` and :func:`json_loads`."""
    return json_loads(file_text(path, most=most))


def json_loads(text: str) -> Any:
    """What a JSON text holds; whole numbers that do not fit into int64 become floats.

    Raises
    ------
    ValueError
        No JSON, nested too deeply, with numbers that float64 cannot hold (``1e999``, ``NaN``), or
        with an escaped lone surrogate in its texts (``"\\ud800"``): what the program makes of
        these could not be written again.
    """
    try:
        content = json.loads(text, parse_int=_whole, parse_float=_finite, parse_constant=_finite)
        if _SURROGATE.search(text):  # most come in pairs, which are one character
            json.dumps(content, ensure_ascii=False).encode()
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except UnicodeEncodeError as error:
        raise ValueError(_NO_CHARACTER) from error
    return content


def load_array(path: Path, *, most: int = ARRAY_BYTES_MAX) -> np.ndarray:
    """The array of a .npy file.

    Raises
    ------
    OSError, ValueError
        As :func:`file_bytes`; or the file is not as long as its header says.
    """
    size = require_bytes(path, most)
    with path.open("rb") as stream:
        _check_header(stream, size)
        stream.seek(0)
        return _text_checked(np.lib.format.read_array(stream, allow_pickle=False))


def load_arrays(
    path: Path, names: Iterable[str], *, most: int = ARRAY_BYTES_MAX
) -> dict[str, np.ndarray]:
    """The named arrays of a .npz file: together at most ``most`` bytes, or as many as the file has.

    So a large file is read, but not a small one that decompresses into a large one.

    Raises
    ------
    OSError, ValueError
        As :func:`file_bytes`; no such archive, an array missing or not as long as its header says.
    """
    size = require_bytes(path, None)
    arrays: dict[str, np.ndarray] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            members = {name: archive.getinfo(f"{name}.npy") for name in names}
            require_plain_packing(members.values())
            together = sum(member.file_size for member in members.values())
            if together > max(most, size):
                raise ValueError(f"its arrays of {together} bytes exceed the {most} that are read")
            for name, member in members.items():
                with archive.open(member) as stream:
                    _check_header(stream, member.file_size)
                with archive.open(member) as stream:
                    array = np.lib.format.read_array(stream, allow_pickle=False)
                    arrays[name] = _text_checked(array)
                    if stream.read(1):  # reaching the end is what checks the CRC
                        raise ValueError(f"{name} is longer than its header says")
    except _BAD_ZIP as error:
        raise ValueError(str(error) or type(error).__name__) from error
    return arrays


def require_plain_packing(members: Iterable[zipfile.ZipInfo]) -> None:
    """ValueError for files in an archive that are neither stored nor deflated.

    LZMA takes a dictionary of the size that it claims, and fails in a way of its own.
    """
    for member in members:
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError(f"{member.filename} is packed in a way that is not read; deflate it")


def require_pixels(width: int, height: int, most: int = PIXELS_MAX) -> None:
    """ValueError for more pixels than ``most``, or none."""
    if min(width, height) < 1:
        raise ValueError(f"{width}x{height} is no size of a picture")
    if width * height > most:
        raise ValueError(f"{width}x{height} are more than {most} pixels, the picture is too large")


def require_size(path: Path, width: int, height: int) -> None:
    """InputError for a picture of more pixels than are read, or of none."""
    try:
        require_pixels(width, height)
    except ValueError as error:
        raise InputError(f"{path}: {error}; scale it down") from error


def _whole(text: str) -> int | float:
    value = _finite(text)  # refuses more digits than int would take long for
    number = int(text)
    return number if -(2**63) <= number < 2**63 else value


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:20]} is no number that is read")
    return value


def _text_checked(array: np.ndarray) -> np.ndarray:
    """The array; ValueError for characters beyond Unicode's, of which numpy makes broken texts."""
    if array.dtype.kind == "U" and array.nbytes:
        code = np.dtype(np.uint32).newbyteorder(array.dtype.byteorder)
        if np.ascontiguousarray(array).reshape(-1).view(code).max() > sys.maxunicode:
            raise ValueError(_NO_CHARACTER)
    return array


def _check_header(stream: Any, size: int) -> None:
    """Refuse a .npy stream of ``size`` bytes whose header tells of another length, or of objects.

    numpy takes the memory that the header asks for before it reads.
    """
    try:
        version = np.lib.format.read_magic(stream)
        read = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        shape, _, dtype = read(stream)
        length = stream.tell() + math.prod(shape) * dtype.itemsize
    except zipfile.BadZipFile:  # the CRC of a short stream
        raise
    # the header is parsed as Python, which fails in as many ways as Python's own parser
    except Exception as error:
        raise ValueError("no .npy array, or its header is damaged") from error
    if dtype.hasobject or dtype.names:
        raise ValueError(f"it holds {'records' if dtype.names else 'objects'}, not numbers")
    if length != size or not all(0 <= side < 2**62 for side in shape):
        raise ValueError(f"its header tells of {length} bytes, it has {size}")


def read_object(path: str | Path, kind: str) -> dict[str, object]:
    """The JSON object in a file whose "kind" says that it is the one wanted."""
    path = Path(path)
    try:
        content = json_content(path)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}; give a {kind} file") from error
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: no JSON ({reason}); give a {kind} file") from error
    if not isinstance(content, dict) or content.get("kind") != kind:
        raise InputError(f'{path}: no {kind} file (its "kind" is not {kind!r}); give another')
    return content


def require_keys(path: str | Path, content: Mapping[str, object], names: list[str]) -> None:
    """Refuse a file that lacks one of these keys."""
    missing = [name for name in names if name not in content]
    if missing:
        raise InputError(f'{path}: "{missing[0]}" is missing; write the file anew')


def read_number(content: Mapping[str, object], name: str) -> float:
    """The number of that key; the message leaves the file's name to the caller."""
    value = content[name]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f'"{name}" must be a number, got {value!r}')
    return float(value)


def read_whole(content: Mapping[str, object], name: str) -> int:
    """The same for a whole number."""
    value = content[name]
    if isinstance(value, bool) or not isinstance(value, int):
        raise InputError(f'"{name}" must be a whole number, got {value!r}')
    return value


def write_json(path: str | Path, content: object) -> None:
    """Write strict JSON: a NaN or infinity is a ValueError, since other readers refuse it."""
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
