"""The manifest of a batch: a line of JSON for each photograph that is done."""

import json
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from skylight.errors import InputError, OutputError
from skylight.io.atomic import atomic_path

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
    ``verdict``  how sure the sun is; ``advice`` what speaks against trust.
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

    Raises
    ------
    InputError
        Another line is damaged; the message says which.
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
    """Add a line, on the disk when this returns.

    Raises
    ------
    OutputError
        The disk does not take it. What was written of it, the next run mends.
    """
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
