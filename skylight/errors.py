"""Exceptions for failures that a user can cause or meet, with their exit codes.

The command line prints the message of a :class:`SkylightError` as one line and exits with its
``exit_code``; anything else is a bug and shows a traceback.
"""

from collections.abc import Sequence
from typing import Any


class SkylightError(Exception):
    """Base class; ``str(error)`` says what is wrong and what to do about it.

    It is one line that any terminal may show, whatever texts of a file and names it quotes: what
    cannot be printed becomes a blank.
    """

    exit_code = 1

    def __str__(self) -> str:
        return "".join(each if each.isprintable() else " " for each in super().__str__())


class InputError(SkylightError):
    """What the user gave cannot be used: a file, an option, a picture without a face."""

    exit_code = 2


class AssetError(SkylightError):
    """A file that skylight itself needs (checkpoint, prior, head model) is missing or damaged."""


class OutputError(SkylightError):
    """A result could not be written."""


class DependencyError(SkylightError):
    """An optional package is needed for this command and is not installed."""


EXTRAS = {  # optional packages, by the names that they are imported by
    "dask": "cluster",
    "distributed": "cluster",
    "dlib": "dlib",
    "fastapi": "studio",
    "igl": "decimation",
    "manifold3d": "print",
    "mitsuba": "render",
    "onnx": "export",
    "onnxscript": "export",
    "pillow_heif": "heif",
    "rawpy": "raw",
    "starlette": "studio",
    "tensorboard": "train",
    "uvicorn": "studio",
    "xatlas": "atlas",
    "yaml": "train",
}


def not_installed(package: str, what: str = "this command") -> DependencyError:
    """``what`` needs ``package``, one of :data:`EXTRAS`: how to install it."""
    extra = EXTRAS[package.partition(".")[0]]
    return DependencyError(
        f"{what} needs {package}, which is not installed: pip install 'skylight-lighting[{extra}]'"
    )


def explain(error: BaseException, *, more: str = "rerun with --debug") -> tuple[str, int]:
    """(what to tell the user, exit code) of whatever ended a command; ``more``: how to learn more.

    ``more`` is said of bugs alone. A missing package of an extra is told by its extra's name.
    """
    if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] in EXTRAS:
        error = not_installed(str(error.name).partition(".")[0])
    if isinstance(error, SkylightError):
        return str(error), error.exit_code
    if isinstance(error, KeyboardInterrupt):
        return "interrupted; the results of earlier runs are untouched", 1
    # torch's allocators raise plain RuntimeErrors
    no_room = isinstance(error, RuntimeError) and (
        "allocate memory" in str(error) or "out of memory" in str(error)
    )
    if isinstance(error, MemoryError) or no_room:
        return "out of memory; close other programs, or use a smaller picture", 1
    if isinstance(error, OSError) and error.strerror:
        file = f"{error.filename}: " if error.filename else ""
        return f"{file}{error.strerror}; check the disk's free space and your access to it", 1
    first = str(error).partition("\n")[0]
    return f"internal error ({type(error).__name__}: {first}); {more}", 1


def check_shape(what: str, shape: Sequence[Any], *last: int, names: str = "") -> None:
    """:class:`InputError` unless the last sizes of a tensor are these, which ``names`` explains.

    An export has symbols for sizes.
    """
    if tuple(shape[-len(last) :]) != last:
        sizes = ", ".join(str(size) for size in last)
        meant = f": {names}" if names else ""
        raise InputError(f"{what} of shape {tuple(shape)}: give (..., {sizes}){meant}")
