"""Illumination of many photographs: a folder of results for each."""

import hashlib
import json
import math
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from skylight.errors import InputError
from skylight.estimate._manifest import (
    MANIFEST,
    BatchSettings,
    Entry,
    append_entry,
    folder_name,
    list_photos,
    photo_hash,
    read_manifest,
    write_manifest,
)
from skylight.estimate._many import Piece, estimate_one, lost
from skylight.faces._landmarkers import choose_landmarker
from skylight.models._names import SKY_LIGHTS
from skylight.work._cluster import Cluster
from skylight.work._device import choose_device
from skylight.work._progress import StageProgress
from skylight.work._resumable import SETTINGS, Workers, claimed, settle, share_work

GPU_BATCH = 16  # photos


def estimate_folder(
    photos: Path,
    out: Path,
    settings: BatchSettings,
    *,
    workers: Workers = 1,
    batch: int | None = None,
    retry_failed: bool = False,
    progress: StageProgress | None = None,
) -> list[Entry]:
    """Estimate the light of every picture below ``photos``; entries in the pictures' order.

    A photo's results go to :func:`folder_name` in ``out``, and then its line to the manifest.
    A run that was stopped goes on: photos with a line are passed over, those that failed too
    unless ``retry_failed``, and those whose bytes have changed are done again. Whatever is wrong
    with a photo is its entry; only what is wrong with the rest (a full disk, other settings, a
    missing model) ends the run.

    So many photos as ``batch`` are solved together on the device of the settings
    (:func:`~skylight.estimate._many.estimate_together`); by default
    :data:`GPU_BATCH` on a GPU for the lights that can be, else each by its worker.

    Memory: each worker takes up to 0.9 GB.

    Raises
    ------
    InputError
        No picture, settings other than those of ``out``, another run at work in ``out``, or a
        batch of what cannot be solved together.
    OutputError
        ``out`` cannot be written to.
    """
    sources = list_photos(photos, out)
    choose_landmarker(settings.landmarks)  # refuses what cannot be used
    together = _batch(settings, workers, batch)
    facts = settings.facts()
    with claimed(out, *(out / folder_name(source) for source in sources)):
        settle(out / SETTINGS, facts)
        entries = read_manifest(out / MANIFEST)
        missing = [
            source
            for source in sources
            if not _is_finished(photos, source, entries.get(source), retry_failed)
        ]
        for source in missing:
            entries.pop(source, None)
        write_manifest(out / MANIFEST, entries.values())
        tell = _teller(progress, sources, entries)
        tell()
        pieces = [
            Piece(
                photos=photos,
                source=source,
                out=out,
                settings=settings,
                settings_hash=_hash(facts),
            )
            for source in missing
        ]
        for entry in _estimates(pieces, together, workers):
            append_entry(out / MANIFEST, entry)
            entries[entry.source] = entry
            tell()
    return [entries[source] for source in sources]


def _batch(settings: BatchSettings, workers: Workers, asked: int | None) -> int:
    """How many photos are solved together."""
    can = settings.light in SKY_LIGHTS and not isinstance(workers, Cluster)
    if asked is None:
        return GPU_BATCH if can and choose_device(settings.device).type != "cpu" else 1
    if asked < 1:
        raise InputError(f"--batch must be 1 or more, got {asked}")
    if asked > 1 and settings.light not in SKY_LIGHTS:
        raise InputError(
            f"--batch is for --light {', '.join(SKY_LIGHTS)}: {settings.light} is solved photo by "
            "photo; leave it out"
        )
    if asked > 1 and not can:
        raise InputError(
            "--batch and --cluster contradict each other: a cluster's workers solve photo by photo"
        )
    return asked


def _estimates(pieces: Sequence[Piece], together: int, workers: Workers) -> Iterator[Entry]:
    if together == 1 or isinstance(workers, Cluster):
        each = [(piece,) for piece in pieces]
        return share_work(estimate_one, each, workers=workers, finish=True, lost=lost)
    # torch, which whoever only shares out photos does not wait for
    from skylight.estimate._many import estimate_together

    return estimate_together(pieces, batch=together, workers=workers)


def _is_finished(photos: Path, source: str, entry: Entry | None, retry_failed: bool) -> bool:
    if entry is None or (entry.status == "failed" and retry_failed):
        return False
    return entry.sha256 == photo_hash(photos / source)


def _hash(facts: dict[str, object]) -> str:
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16]


def time_left_s(seconds: Sequence[float], elapsed_s: float, left: int) -> float:
    """Seconds that ``left`` more photos take, from those that took ``seconds`` in ``elapsed_s``.

    The median photo stands for one to come, sum(seconds) / elapsed for the workers at work: a
    photo that is quickly refused hardly counts, and workers may come and go.
    """
    return left * statistics.median(seconds) * elapsed_s / math.fsum(seconds)


def _teller(
    progress: StageProgress | None, sources: Sequence[str], entries: Mapping[str, Entry]
) -> Callable[[], None]:
    """Tells of the entries that are there; time counts from now."""
    begun, before = time.monotonic(), set(entries)

    def tell() -> None:
        if progress is None:
            return
        there = [entries[source] for source in sources if source in entries]
        failed = sum(entry.status == "failed" for entry in there)
        text = f"photo {len(there)} of {len(sources)}" + (f", {failed} failed" if failed else "")
        seconds = [e.seconds for e in there if e.source not in before and e.seconds]
        if seconds and len(there) < len(sources):
            left = time_left_s(seconds, time.monotonic() - begun, len(sources) - len(there))
            text += f", {left / 60:.0f} min left" if left > 90 else f", {left:.0f} s left"
        progress(text, len(there) / len(sources))

    return tell
