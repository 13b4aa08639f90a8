"""Training skies, converted once to memory-mapped arrays."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from skylight.errors import InputError
from skylight.io.atomic import atomic_path
from skylight.models.networks.base import HEIGHT, WIDTH
from skylight.skies.index import SkyRecord, folder_hash, read_index
from skylight.skies.loading import load_skies
from skylight.training.skies.cores import in_order
from skylight.work.progress import Tell

CHUNK = 32  # skies that one process converts at a time
CACHE = ".cache"


@dataclass(frozen=True, kw_only=True)
class SkyData:
    """Training and validation skies (n,h,w,3), mapped from disk; where they lie, by the names
    "train" and "validation"; and the hash of their data."""

    train: Float[np.ndarray, "n h w 3"]
    validation: Float[np.ndarray, "m h w 3"]
    paths: dict[str, Path]
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
    paths = {split: _cache_path(place, digest, split) for split in ("train", "validation")}
    train, validation = (np.load(path, mmap_mode="r") for path in paths.values())
    return SkyData(train=train, validation=validation, paths=paths, hash=digest)


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
    """The skies of ``records`` in order, ``CHUNK`` at a time."""
    yield from in_order(
        _convert, [(place, records[i : i + CHUNK]) for i in range(0, len(records), CHUNK)]
    )


def _convert(chunk: tuple[Path, list[SkyRecord]]) -> Float[np.ndarray, "_ h w 3"]:
    return load_skies(*chunk, height=HEIGHT).numpy()
