"""The manifest of a batch: a line of JSON for each photograph that is done.

The photographs of a folder, and where the results of each go.

What the estimates of a folder depend on besides its photographs.
"""

import hashlib
import json
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from skylight.errors import InputError, OutputError
from skylight.faces._names import HeadName, LandmarkerName, WhichFaces
from skylight.imaging._photo import PHOTO_SUFFIXES
from skylight.io._atomic import atomic_path
from skylight.io._files import visible_files
from skylight.models._ground import KnownGround, check_has_ground
from skylight.models._names import (
    DEFAULT_LIGHT,
    DEFAULT_SOLVER,
    LightName,
    SolverName,
    check_is_trained,
    check_light_name,
    check_solver_name,
)

if TYPE_CHECKING:
    from skylight.imaging._colour import Decode


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


@dataclass(frozen=True, kw_only=True)
class BatchSettings:
    """What every estimate of a batch depends on besides its photo; as in ``skylight.estimate``.

    With ``keep_place`` results tell time, place and heading.
    """

    light: LightName = DEFAULT_LIGHT
    model: Path | None = None
    solver: SolverName = DEFAULT_SOLVER
    face: WhichFaces = 1
    head: HeadName = "fitted"
    decode: "Decode | None" = None
    landmarks: LandmarkerName = "mediapipe"
    ignore_exif_sun: bool = False
    keep_place: bool = False
    ground: KnownGround | None = None
    device: str = "auto"

    def __post_init__(self) -> None:
        check_light_name(self.light)
        check_solver_name(self.solver, self.light)
        check_has_ground(self.light, self.ground)
        if self.model is not None:
            check_is_trained(self.light)

    def facts(self) -> dict[str, object]:
        """For notes: the same for the same model files, wherever they lie, and on any device."""
        fingerprint = None
        if self.model is not None:
            from skylight.models._bundle import load_bundle

            fingerprint = load_bundle(self.model).fingerprint
        facts: dict[str, object] = {**asdict(self), "model": fingerprint}
        del facts["device"]
        if self.solver == DEFAULT_SOLVER:  # notes of runs before there was another
            del facts["solver"]
        if self.ground is None:
            del facts["ground"]
        return facts
