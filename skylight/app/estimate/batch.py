"""Illumination of many photographs: a folder of results for each."""

import hashlib
import json
import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skylight.app.estimate.manifest import (
    MANIFEST,
    Entry,
    append_entry,
    read_manifest,
    write_manifest,
)
from skylight.errors import DependencyError, InputError, SkylightError
from skylight.faces.detection.landmarkers import choose_landmarker
from skylight.faces.names import HeadName, LandmarkerName, WhichFaces
from skylight.imaging.suffixes import PHOTO_SUFFIXES
from skylight.io.listing import visible_files
from skylight.models.known_ground import KnownGround, check_has_ground
from skylight.models.names import (
    DEFAULT_LIGHT,
    DEFAULT_SOLVER,
    LightName,
    SolverName,
    check_is_trained,
    check_light_name,
    check_solver_name,
)
from skylight.work.progress import StageProgress
from skylight.work.resumable import Workers, claimed, settle, share_work

if TYPE_CHECKING:
    from skylight.imaging.colour import Decode

SETTINGS = "settings.json"


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
            from skylight.models.bundle import load_bundle

            fingerprint = load_bundle(self.model).fingerprint
        facts: dict[str, object] = {**asdict(self), "model": fingerprint}
        del facts["device"]
        if self.solver == DEFAULT_SOLVER:  # notes of runs before there was another
            del facts["solver"]
        if self.ground is None:
            del facts["ground"]
        return facts


def estimate_folder(
    photos: Path,
    out: Path,
    settings: BatchSettings,
    *,
    workers: Workers = 1,
    retry_failed: bool = False,
    progress: StageProgress | None = None,
) -> list[Entry]:
    """Estimate the light of every picture below ``photos``; entries in the pictures' order.

    A photo's results go to :func:`folder_name` in ``out``, and then its line to the manifest.
    A run that was stopped goes on: photos with a line are passed over, those that failed too
    unless ``retry_failed``, and those whose bytes have changed are done again. Whatever is wrong
    with a photo is its entry; only what is wrong with the rest (a full disk, other settings, a
    missing model) ends the run.

    Memory: each worker takes up to 1.1 GB.

    Raises
    ------
    InputError
        No picture, settings other than those of ``out``, or another run at work in ``out``.
    OutputError
        ``out`` cannot be written to.
    """
    sources = list_photos(photos, out)
    choose_landmarker(settings.landmarks)  # refuses what cannot be used
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
        work = [(photos, source, out, settings, _hash(facts)) for source in missing]
        for entry in share_work(estimate_one, work, workers=workers, finish=True, lost=_lost):
            append_entry(out / MANIFEST, entry)
            entries[entry.source] = entry
            tell()
    return [entries[source] for source in sources]


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


def estimate_one(
    photos: Path, source: str, out: Path, settings: BatchSettings, settings_hash: str
) -> Entry:
    """One photo, in a worker: its results, and what the manifest says of it.

    Raises
    ------
    OutputError, AssetError
        What would be wrong with every photo: a full disk, a damaged installation.
    """
    begun = time.perf_counter()
    path = photos / source
    sha256, told, error = _photo_hash(path), None, ""
    try:
        told = _estimate_into(out / folder_name(source), path, source, settings)
    except (InputError, DependencyError) as fault:
        error = str(fault).replace(str(path), source)
    except SkylightError:
        raise
    except Exception as fault:
        first = str(fault).partition("\n")[0]
        error = f"{source}: internal error ({type(fault).__name__}: {first})"
    common = {
        "source": source,
        "sha256": sha256,
        "settings": settings_hash,
        "seconds": round(time.perf_counter() - begun, 3),
    }
    if told is None:
        return Entry(**common, status="failed", error=" ".join(error.split()))
    return Entry(
        **common,
        status="done",
        results=folder_name(source),
        sun=told["sun"],
        verdict=told["posterior"]["verdict"],
        advice=told["advice"],
        versions=told["versions"],
    )


def _estimate_into(out: Path, path: Path, source: str, settings: BatchSettings) -> dict[str, Any]:
    """Estimate a photo and write its results; what estimate.json says."""
    # torch takes 2 s to import, which whoever only shares out photos does not wait for
    from skylight.app.estimate.photos import estimate_photo
    from skylight.app.estimate.results import MESHES, write_results
    from skylight.imaging.photo import read_photo
    from skylight.work.results_folder import results_folder

    photo = read_photo(path, decode=settings.decode)
    with results_folder(out, MESHES) as folder:
        result = estimate_photo(
            photo,
            light=settings.light,
            model=settings.model,
            solver=settings.solver,
            face=settings.face,
            head=settings.head,
            device=settings.device,
            landmarks=choose_landmarker(settings.landmarks),
            ignore_exif_sun=settings.ignore_exif_sun,
            ground=settings.ground,
            names=[source],
            workers=1,
        )
        write_results(folder, result, keep_place=settings.keep_place)
        return json.loads((folder / "estimate.json").read_text(encoding="utf-8"))


def _lost(
    photos: Path, source: str, out: Path, settings: BatchSettings, settings_hash: str
) -> Entry:
    return Entry(
        source=source,
        sha256=_photo_hash(photos / source),
        settings=settings_hash,
        status="failed",
        error=f"{source}: its workers were killed again and again, so memory may be short: try "
        "again with --retry-failed and fewer workers, or more memory for each",
    )


def _is_finished(photos: Path, source: str, entry: Entry | None, retry_failed: bool) -> bool:
    if entry is None or (entry.status == "failed" and retry_failed):
        return False
    return entry.sha256 == _photo_hash(photos / source)


def _photo_hash(path: Path) -> str | None:
    """None where it cannot be read: reading it as a photo tells why."""
    try:
        return file_hash(path)
    except InputError:
        return None


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
