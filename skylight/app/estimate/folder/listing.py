"""The photographs of a folder, and where the results of each go."""

import hashlib
from pathlib import Path

from skylight.errors import InputError
from skylight.imaging.suffixes import PHOTO_SUFFIXES
from skylight.io.listing import visible_files


def list_photos(photos: Path, out: Path) -> list[str]:
    """Paths of the pictures below ``photos``, from there on, sorted.

    Left out are hidden ones, and the results of estimates: all in ``out`` where that is inside, and
    whatever lies beside an ``estimate.json``.

    Raises
    ------
    InputError
        There is no such folder, or no picture in it.
    """
    if not photos.is_dir():
        raise InputError(f"{photos}: there is no such folder; give one with pictures")
    root, results = photos.resolve(), out.resolve()
    if root == results:
        raise InputError(f"{out}: results go to another folder than the pictures; choose one")
    found = []
    for path in visible_files(root, PHOTO_SUFFIXES, recursive=True):
        is_result = root in results.parents and results in path.parents
        # reports of earlier estimates show the faces too
        is_result = is_result or (path.parent / "estimate.json").exists()
        if not is_result:
            found.append(path.relative_to(root).as_posix())
    if not found:
        raise InputError(
            f"{photos}: no pictures ({', '.join(sorted(PHOTO_SUFFIXES))}) in this folder"
        )
    return sorted(found)


def folder_name(source: str) -> str:
    """``a/me.jpg`` gets ``a/me_jpg``: no two photos share a folder, whatever is added later."""
    stem, _, suffix = source.rpartition(".")
    return f"{stem}_{suffix}"


def file_hash(path: Path) -> str:
    """SHA-256 of a file.

    Raises
    ------
    InputError
        It cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}; give a file") from error


def photo_hash(path: Path) -> str | None:
    """None where it cannot be read: reading it as a photo tells why."""
    try:
        return file_hash(path)
    except InputError:
        return None
