"""The photographs of a folder, where the results of each go, and the manifest of what is done.

The manifest has a line of JSON for each photograph.
"""

import hashlib
import json
import os
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from skylight.errors import InputError, OutputError
from skylight.imaging._photo import PHOTO_SUFFIXES
from skylight.io._atomic import atomic_path
from skylight.io._files import visible_files

MANIFEST = "manifest.jsonl"


@dataclass(frozen=True, kw_only=True)
class Entry:
    """What came of a photo.

    ``source``   its path from the folder of photos on, with ``/``.
    ``sha256``   of its bytes; None where they could not be read.
    ``settings`` hash of what the estimate depends on besides the photo.
    ``results``  its folder of results, from that of all results on; None where it failed.
    ``error``    one line, empty where it is done.
    ``seconds``  of one worker; None where that was lost.
    ``sun``      azimuth_deg and zenith_deg in the camera's frame, as in estimate.json.
    ``verdict``  how sure the light is; ``advice`` what speaks against trust.
    """

    source: str
    sha256: str | None
    settings: str
    status: Literal["done", "failed"]
    error: str = ""
    seconds: float | None = None
    results: str | None = None
    sun: dict[str, float] | None = None
    verdict: str | None = None
    advice: list[str] = field(default_factory=list)
    versions: dict[str, str | None] = field(default_factory=dict)


def read_manifest(path: Path) -> dict[str, Entry]:
    """Entries by source; none where there is no file.

    A last line that a kill or a full disk cut off does not count.
    """
    if not path.exists():
        return {}
    *lines, torn = path.read_bytes().split(b"\n")
    entries: dict[str, Entry] = {}
    for number, line in enumerate(lines, start=1):
        try:
            entry = Entry(**json.loads(line))
            entries[entry.source] = entry
        except (ValueError, TypeError, RecursionError) as error:
            if number == len(lines) and not torn:
                break
            raise InputError(
                f"{path}, line {number}: damaged ({error}); delete the line, and its photo is "
                "done again"
            ) from error
    return entries


def write_manifest(path: Path, entries: Iterable[Entry]) -> None:
    """Write all of it anew, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text("".join(map(_line, entries)), encoding="utf-8")


def append_entry(path: Path, entry: Entry) -> None:
    """Add a line, on the disk when this returns."""
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write(_line(entry))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise OutputError(
            f"cannot write {path}: {error.strerror}; the photos in it are done: mend this, and "
            "run the same command again"
        ) from error


def _line(entry: Entry) -> str:
    return json.dumps(asdict(entry), allow_nan=False) + "\n"


def list_photos(photos: Path, out: Path) -> list[str]:
    """Paths of the pictures below ``photos``, from there on, sorted.

    Left out are hidden ones, and results: all in ``out`` where that is inside, and whatever lies
    beside an ``estimate.json`` or below a folder with a :data:`MANIFEST`.
    """
    if not photos.is_dir():
        raise InputError(f"{photos}: there is no such folder; give one with pictures")
    if photos.resolve() == out.resolve():
        raise InputError(f"{out}: results go to another folder than the pictures; choose one")
    found = _given(photos, out, PHOTO_SUFFIXES)
    if not found:
        raise InputError(
            f"{photos}: no pictures ({', '.join(sorted(PHOTO_SUFFIXES))}) in this folder"
        )
    return found


def left_out(photos: Path, out: Path) -> str:
    """What :func:`list_photos` passes over by its suffix, such as "2 .txt, 1 .psd"; or nothing."""
    suffixes = [Path(source).suffix.lower() for source in _given(photos, out, None)]
    counts = Counter(suffix for suffix in suffixes if suffix not in PHOTO_SUFFIXES)
    return ", ".join(f"{count} {suffix or 'without a suffix'}" for suffix, count in counts.items())


def _given(photos: Path, out: Path, suffixes: Collection[str] | None) -> list[str]:
    """Files below ``photos`` that are no results of estimates, from there on, sorted."""
    root, results = photos.resolve(), out.resolve()
    found: list[str] = []
    made: dict[Path, bool] = {}  # whether folders are, or lie in, those of a batch's results

    def is_made(folder: Path) -> bool:
        if folder == root:
            return False
        if folder not in made:
            made[folder] = (folder / MANIFEST).exists() or is_made(folder.parent)
        return made[folder]

    for path in visible_files(root, suffixes, recursive=True):
        is_result = root in results.parents and results in path.parents
        # reports of earlier estimates show the faces too
        is_result = is_result or (path.parent / "estimate.json").exists() or is_made(path.parent)
        if not is_result:
            found.append(path.relative_to(root).as_posix())
    return sorted(found)


def folder_name(source: str) -> str:
    """``a/me.jpg`` gets ``a/me_jpg``: no two photos share a folder, whatever is added later."""
    stem, _, suffix = source.rpartition(".")
    return f"{stem}_{suffix}"


def file_hash(path: Path) -> str:
    """SHA-256 of a file."""
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
