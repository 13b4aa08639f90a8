"""Many portraits relit: those of all estimates in a folder, which are not estimated again."""

import hashlib
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from skylight.errors import InputError
from skylight.estimation._folder import attempted, teller
from skylight.estimation._kept import KEPT, read_face
from skylight.estimation._manifest import (
    MANIFEST,
    Entry,
    append_entry,
    file_hash,
    photo_hash,
    read_manifest,
    write_manifest,
)
from skylight.io._files import visible_files
from skylight.portrait._asked import AskedLight, written_pictures
from skylight.work._progress import StageProgress
from skylight.work._resumable import Workers, locked, share_work

ESTIMATES = "estimates"  # the folder of a folder's estimates, in that of its pictures


@dataclass(frozen=True, kw_only=True)
class RelitPiece:
    """The estimate in ``folder``/``source``, whose pictures go below ``out``."""

    folder: Path
    source: str
    out: Path
    lights: tuple[AskedLight, ...]
    exposure: float
    settings_hash: str

    @property
    def estimate(self) -> Path:
        return self.folder / self.source

    def pictures(self) -> dict[Path, AskedLight]:
        """``a/me_jpg`` gets ``a/me_jpg_left.png``, and so on."""
        stem = self.out / self.source
        return {stem.with_name(f"{stem.name}_{light.name}.png"): light for light in self.lights}

    def entry(self, sha256: str | None, seconds: float | None, error: str, *told: str) -> Entry:
        return Entry(
            source=self.source,
            sha256=sha256,
            settings=self.settings_hash,
            status="failed" if error else "done",
            error=error,
            seconds=None if seconds is None else round(seconds, 3),
            advice=list(dict.fromkeys(told)),
        )

    def is_finished(self, entry: Entry | None) -> bool:
        """Whether an earlier run made the same pictures of the same estimate, and they are there.

        One that failed is tried again: that takes seconds.
        """
        return (
            entry is not None
            and entry.status == "done"
            and entry.settings == self.settings_hash
            and entry.sha256 == photo_hash(self.estimate / KEPT)
            and all(path.is_file() for path in self.pictures())
        )


def estimates_below(folder: Path) -> list[str]:
    """Folders of estimates below ``folder``, from there on, sorted."""
    found = visible_files(folder.resolve(), {".json"}, recursive=True)
    kept = (path.parent for path in found if path.name == "estimate.json")
    return sorted(path.relative_to(folder.resolve()).as_posix() for path in kept)


def relight_folder(
    folder: Path,
    out: Path,
    lights: Sequence[AskedLight],
    *,
    exposure: float = 1.0,
    workers: Workers = 1,
    progress: StageProgress | None = None,
) -> list[Entry]:
    """The face of every estimate below ``folder`` in each of the lights; entries in order.

    ``out`` gets a line of its manifest for each estimate, and goes on as
    :func:`~skylight.estimation._folder.estimate_folder` does: what is wrong with an estimate or its
    photograph is its entry, and only what is wrong with the rest ends the run.

    Raises
    ------
    InputError
        No estimate, or another run at work in ``out``.
    OutputError
        ``out`` cannot be written to.
    """
    sources = estimates_below(folder)
    if not sources:
        raise InputError(f"{folder}: no estimate in this folder; make some with skylight estimate")
    facts = {"exposure": exposure, "lights": {one.name: dict(one.facts) for one in lights}}
    settings_hash = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16]
    pieces = {
        source: RelitPiece(
            folder=folder,
            source=source,
            out=out,
            lights=tuple(lights),
            exposure=exposure,
            settings_hash=settings_hash,
        )
        for source in sources
    }
    with locked(out):
        entries = read_manifest(out / MANIFEST)
        missing = [one for one in pieces.values() if not one.is_finished(entries.get(one.source))]
        for piece in missing:
            entries.pop(piece.source, None)
        write_manifest(out / MANIFEST, entries.values())
        tell = teller(progress, sources, entries)
        tell()
        each = [(piece,) for piece in missing]
        for entry in share_work(relight_one, each, workers=workers, finish=True, lost=_lost):
            append_entry(out / MANIFEST, entry)
            entries[entry.source] = entry
            tell()
    return [entries[source] for source in sources]


def relight_one(piece: RelitPiece) -> Entry:
    """One estimate, in a worker: its pictures, and what the manifest says of it."""
    begun = time.perf_counter()

    def written() -> tuple[str, tuple[str, ...]]:
        sha256, face = file_hash(piece.estimate / KEPT), read_face(piece.estimate)
        pictures = piece.pictures()
        next(iter(pictures)).parent.mkdir(parents=True, exist_ok=True)
        told = list(face.advice)
        for relit in written_pictures(face, pictures, exposure=piece.exposure, workers=1):
            told += [note for note in (relit.warning, *relit.notes) if note]
        return sha256, tuple(told)

    done, error = attempted(written, piece.estimate, piece.source)
    sha256, told = done or (photo_hash(piece.estimate / KEPT), ())
    return piece.entry(sha256, time.perf_counter() - begun, error, *told)


def _lost(piece: RelitPiece) -> Entry:
    """Of an estimate that no worker survived."""
    return piece.entry(
        None, None, f"{piece.source}: its workers were killed again and again: memory may be short"
    )
