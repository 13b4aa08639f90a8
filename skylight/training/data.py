"""Training skies, converted once to memory-mapped arrays."""

import hashlib
import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from skylight.errors import InputError, SkylightError
from skylight.io.atomic import atomic_path
from skylight.models.autoencoder import HEIGHT, WIDTH
from skylight.skies.index import SkyRecord, folder_hash, read_index
from skylight.skies.loading import load_skies
from skylight.work.progress import Tell

CHUNK = 32  # skies that one process converts at a time
CACHE = ".cache"


@dataclass(frozen=True, kw_only=True)
class SkyData:
    """Training and validation skies (n,h,w,3), mapped from disk, and the hash of their data."""

    train: Float[np.ndarray, "n h w 3"]
    validation: Float[np.ndarray, "m h w 3"]
    hash: str


def load_data(place: Path, report: Tell = print) -> SkyData:
    """The training and validation days of an index (its file or folder), converted once.

    ``.cache`` beside the index keeps them as float32 arrays named by the hash of the data, each
    with its SHA-256; one that does not agree is made anew, which ``report`` is told.

    Raises
    ------
    InputError
        No index, a map that cannot be read, or a split without days.
    """
    records = read_index(place)
    splits = {s: [r for r in records if r.split == s] for s in ("train", "validation")}
    if not all(splits.values()):
        raise InputError(
            f"{place}: too few days: training and validation split by day, and one is empty"
        )
    digest = folder_hash(place, records)
    for split, rows in splits.items():
        path = _cache_path(place, digest, split)
        fault = _fault(path, len(rows))
        if fault == "missing":
            report(f"{place}: reading {len(rows)} {split} skies, this once")
        elif fault:
            report(f"{path}: damaged ({fault}); made anew")
        if fault:
            _write_cache(path, place, rows, report)
    return open_cache(place, digest)


def open_cache(place: Path, digest: str) -> SkyData:
    """The data that :func:`load_data` has just checked, in another process."""
    train, validation = (
        np.load(_cache_path(place, digest, split), mmap_mode="r")
        for split in ("train", "validation")
    )
    return SkyData(train=train, validation=validation, hash=digest)


def _cache_path(place: Path, digest: str, split: str) -> Path:
    folder = place.parent if place.is_file() else place
    return folder / CACHE / f"{digest[:16]}-{split}.npy"


def _fault(path: Path, count: int) -> str | None:
    """Why a cache cannot be used: missing, its shape, or its checksum."""
    if not path.exists():
        return "missing"
    try:
        skies = np.load(path, mmap_mode="r")
        expected = path.with_suffix(".sha256").read_text()
        with path.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError, EOFError) as error:
        return type(error).__name__
    if skies.shape != (count, HEIGHT, WIDTH, 3) or skies.dtype != np.float32:
        return f"{skies.dtype} of shape {skies.shape}"
    return None if found == expected else "its checksum differs"


def _write_cache(path: Path, place: Path, records: list[SkyRecord], report: Tell) -> None:
    path.parent.mkdir(exist_ok=True)
    with atomic_path(path) as temporary:
        shape = (len(records), HEIGHT, WIDTH, 3)
        skies = np.lib.format.open_memmap(temporary, mode="w+", dtype=np.float32, shape=shape)
        done = told = 0
        for part in _converted(place, records):
            skies[done : done + len(part)] = part
            done += len(part)
            if done - told >= len(records) / 10 and len(records) > 10 * CHUNK:
                report(f"{done} of {len(records)} skies read")
                told = done
        skies.flush()
        # before the array takes its place: an array without a checksum is a damaged one
        with temporary.open("rb") as file, atomic_path(path.with_suffix(".sha256")) as beside:
            beside.write_text(hashlib.file_digest(file, "sha256").hexdigest())


def _converted(place: Path, records: list[SkyRecord]) -> Iterator[Float[np.ndarray, "_ h w 3"]]:
    """The skies of ``records`` in order, ``CHUNK`` at a time, by as many processes as cores."""
    chunks = [(place, records[i : i + CHUNK]) for i in range(0, len(records), CHUNK)]
    workers = min(os.cpu_count() or 1, len(chunks))
    if workers == 1:
        yield from map(_convert, chunks)
        return
    # spawned, because a process that has run torch's threads cannot be forked safely
    with ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=torch.set_num_threads,
        initargs=(1,),
    ) as pool:
        try:
            yield from pool.map(_convert, chunks)
        except BrokenProcessPool as error:
            raise SkylightError(
                "a process that read skies died; where memory is short, let the same command run "
                "alone, and again"
            ) from error


def _convert(chunk: tuple[Path, list[SkyRecord]]) -> Float[np.ndarray, "_ h w 3"]:
    return load_skies(*chunk, height=HEIGHT).numpy()
