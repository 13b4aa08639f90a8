"""Illumination of many photographs: a folder of results for each.

Each photograph goes through :class:`~skylight.estimation._photos.Pictures`: wholly in a worker
(:func:`estimate_one`), or, on a GPU, up to the light and after it in workers, and its light is
found by this process together with others' (:func:`estimate_together`).
"""

import hashlib
import json
import logging
import math
import statistics
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import torch

from skylight._names import SKY_LIGHTS
from skylight.errors import DependencyError, InputError, SkylightError
from skylight.estimation._manifest import (
    MANIFEST,
    Entry,
    append_entry,
    folder_name,
    list_photos,
    photo_hash,
    read_manifest,
    write_manifest,
)
from skylight.estimation._photos import STAGES, Pictures
from skylight.estimation._report import SOME_FILES, write_results
from skylight.estimation._settings import EstimateSettings
from skylight.estimation._summary import PhotoEstimate, SeenFace
from skylight.inverse._own_light import solved_together
from skylight.inverse._problem import solve
from skylight.inverse._result import Estimate
from skylight.inverse._sun_prior import SunPrior
from skylight.models._base import name_of
from skylight.work._cluster import Cluster
from skylight.work._device import choose_device
from skylight.work._processes import send_tensors_by_value
from skylight.work._progress import StageProgress
from skylight.work._resumable import (
    SETTINGS,
    Workers,
    keep_settings,
    locked,
    results_folder,
    share_work,
)

GPU_BATCH = 16  # photos
T = TypeVar("T")


def estimate_folder(
    photos: Path,
    out: Path,
    settings: EstimateSettings,
    *,
    keep_place: bool = False,
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

    With ``keep_place`` results tell time, place and heading. So many photos as ``batch`` are solved
    together on the device of the settings (:func:`estimate_together`); by default
    :data:`GPU_BATCH` on a GPU for the lights that can be, else each by its worker.

    Memory: each worker takes up to 1 GB.

    Raises
    ------
    InputError
        No picture, settings other than those of ``out``, another run at work in ``out``, or a
        batch of what cannot be solved together.
    OutputError
        ``out`` cannot be written to.
    """
    sources = list_photos(photos, out)
    _ = settings.landmarker  # refuses what cannot be used
    together = _batch(settings, workers, batch)
    settings = settings.with_model  # which workers may not be able to read: whose class is theirs?
    facts = settings.facts() | {"keep_place": keep_place}
    settings_hash = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16]
    with locked(out, *(out / folder_name(source) for source in sources)):
        keep_settings(out / SETTINGS, facts)
        entries = read_manifest(out / MANIFEST)
        missing = [
            source
            for source in sources
            if not _is_finished(photos, source, entries.get(source), retry_failed)
        ]
        for source in missing:
            entries.pop(source, None)
        write_manifest(out / MANIFEST, entries.values())
        tell = teller(progress, sources, entries)
        tell()
        pieces = [
            Piece(
                photos=photos,
                source=source,
                out=out,
                settings=settings,
                settings_hash=settings_hash,
                keep_place=keep_place,
            )
            for source in missing
        ]
        for entry in _estimates(pieces, together, workers):
            append_entry(out / MANIFEST, entry)
            entries[entry.source] = entry
            tell()
    return [entries[source] for source in sources]


def _batch(settings: EstimateSettings, workers: Workers, asked: int | None) -> int:
    """How many photos are solved together."""
    alike = solved_together(settings.light, settings.prior)
    can = alike and not isinstance(workers, Cluster)
    if asked is None:
        return GPU_BATCH if can and choose_device(settings.device).type != "cpu" else 1
    if asked < 1:
        raise InputError(f"--batch must be 1 or more, got {asked}")
    if asked > 1 and not alike:
        raise InputError(
            f"--batch is for --light {', '.join(SKY_LIGHTS)}: {name_of(settings.light)} is solved "
            "photo by photo; leave it out, or choose one of these"
        )
    if asked > 1 and not can:
        raise InputError(
            "--batch and --cluster contradict each other: a cluster's workers solve photo by photo"
        )
    return asked


def _estimates(pieces: Sequence["Piece"], together: int, workers: Workers) -> Iterator[Entry]:
    if together == 1 or isinstance(workers, Cluster):
        each = [(piece,) for piece in pieces]
        return share_work(estimate_one, each, workers=workers, finish=True, lost=lost)
    return estimate_together(pieces, batch=together, workers=workers)


def _is_finished(photos: Path, source: str, entry: Entry | None, retry_failed: bool) -> bool:
    if entry is None or (entry.status == "failed" and retry_failed):
        return False
    return entry.sha256 == photo_hash(photos / source)


def time_left_s(seconds: Sequence[float], elapsed_s: float, left: int) -> float:
    """Seconds that ``left`` more photos take, from those that took ``seconds`` in ``elapsed_s``.

    The median photo stands for one to come, sum(seconds) / elapsed for the workers at work: a
    photo that is quickly refused hardly counts, and workers may come and go.
    """
    return left * statistics.median(seconds) * elapsed_s / math.fsum(seconds)


def teller(
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


@dataclass(frozen=True, kw_only=True)
class Piece:
    """A photo of the folder ``photos``, whose results go below ``out``.

    ``settings_hash`` is that of what the manifest says about the settings.
    """

    photos: Path
    source: str
    out: Path
    settings: EstimateSettings
    settings_hash: str
    keep_place: bool

    @property
    def path(self) -> Path:
        return self.photos / self.source

    @property
    def folder(self) -> Path:
        return self.out / folder_name(self.source)

    def pictures(self) -> Pictures:
        """The photo, read; light is traced by one process."""
        return Pictures.of([self.path], self.settings, names=[self.source], workers=1)

    def attempt(self, work: Callable[[], T]) -> tuple[T | None, str]:
        """:func:`attempted` of the photo."""
        return attempted(work, self.path, self.source)

    def write(self, result: Callable[[], PhotoEstimate]) -> dict[str, Any]:
        """Claim the folder, write what comes of the photo; what its estimate.json says."""
        with results_folder(self.folder, SOME_FILES) as folder:
            write_results(folder, result(), keep_place=self.keep_place)
            return json.loads((folder / "estimate.json").read_text(encoding="utf-8"))

    def entry(
        self,
        sha256: str | None,
        seconds: float | None,
        content: dict[str, Any] | None,
        error: str = "",
    ) -> Entry:
        """Done, with what its estimate.json says, or failed by an error in one line."""
        entry = Entry(
            source=self.source,
            sha256=sha256,
            settings=self.settings_hash,
            status="failed",
            error=error,
            seconds=None if seconds is None else round(seconds, 3),
        )
        if content is None:
            return entry
        return replace(
            entry,
            status="done",
            results=folder_name(self.source),
            sun=content["sun"],
            verdict=content["verdict"]["summary"],
            advice=content["advice"],
            versions=content["versions"],
        )


def attempted(work: Callable[[], T], path: Path, source: str) -> tuple[T | None, str]:
    """(what ``work`` makes, ""), or (None, the error of the photo at ``path`` in one line).

    What would be wrong with every photo, a full disk or a damaged installation, is raised.
    """
    try:
        return work(), ""
    except (InputError, DependencyError) as fault:
        error = str(fault).replace(str(path), source)
    except SkylightError:
        raise
    except Exception as fault:
        first = str(fault).partition("\n")[0]
        error = f"{source}: internal error ({type(fault).__name__}: {first})"
    return None, " ".join(error.split())


def estimate_one(piece: Piece) -> Entry:
    """One photo, in a worker: its results, and what the manifest says of it."""
    begun = time.perf_counter()
    sha256 = photo_hash(piece.path)
    content, error = piece.attempt(lambda: piece.write(piece.pictures().estimate))
    return piece.entry(sha256, time.perf_counter() - begun, content, error)


def lost(piece: Piece) -> Entry:
    """Of a photo that no worker survived."""
    return piece.entry(
        photo_hash(piece.path),
        None,
        None,
        f"{piece.source}: its workers were killed again and again, so memory may be short: try "
        "again with --retry-failed and fewer workers, or more memory for each",
    )


@dataclass(frozen=True, kw_only=True)
class Observed:
    """A photo whose faces were seen, and what that took; its light is not known yet."""

    piece: Piece
    sha256: str | None
    seen: tuple[SeenFace, ...]
    left_out: list[str]
    sun_prior: SunPrior | None
    exposure: float | None
    stages: dict[str, float]
    seconds: float

    @property
    def source(self) -> str:
        return self.piece.source


def estimate_together(pieces: Sequence[Piece], *, batch: int, workers: int) -> Iterator[Entry]:
    """The entry of each photo, once its results are written.

    ``workers`` processes read photos, find faces, fit heads and trace light by embree; as soon as
    ``batch`` faces were seen, this process solves for their lights together on the device of the
    settings; and workers write the results, before they look at further photos. A light is the one
    that the photo gets by itself but for rounding (:func:`~skylight.inverse._problem.solve`), and
    everything else is the same.

    What fails with one photo is its entry: where a batch cannot be solved, each of it is solved by
    itself. At Ctrl-C results that are being written are finished, and come before the interrupt.

    Memory: 60 MB for each face of a batch, and what :class:`~skylight.inverse._sky.SkyProblem`
    says, on the device.
    """
    if not pieces:
        return
    send_tensors_by_value()
    settings = pieces[0].settings.with_model
    (needs,) = settings.problems()
    queue: deque[tuple] = deque(
        (_observe, piece, needs.grid_height, needs.uses_specular) for piece in pieces
    )
    left, waiting = {piece.source for piece in pieces}, []
    stream = share_work(
        _run, queue, workers=workers, finish=lambda step, *_: step is _write, lost=_lost
    )
    for result in stream:
        left.discard(result.source)
        if isinstance(result, Entry):
            yield result
        else:
            waiting.append(result)
        if waiting and (sum(len(one.seen) for one in waiting) >= batch or not left):
            begun = time.perf_counter()
            try:
                lights = _lights(waiting, settings)
            except KeyboardInterrupt as interrupt:
                yield from _finished(stream, interrupt)
                raise
            share = (time.perf_counter() - begun) / len(waiting)
            for one, (light, error) in zip(waiting, lights, strict=True):
                if light is None:
                    yield one.piece.entry(one.sha256, one.seconds + share, None, error)
                else:
                    queue.appendleft((_write, one.piece, _solved(one, share), light))
            waiting = []


def _finished(
    stream: Generator[Entry | Observed, None, None], interrupt: KeyboardInterrupt
) -> Iterator[Entry]:
    """The photos whose results are being written, and then the interrupt."""
    result = stream.throw(interrupt)
    while isinstance(result, Entry):
        yield result
        result = next(stream)


def _run(step: Callable[..., Any], piece: Piece, *more: Any) -> Entry | Observed:
    """A step of a photo, in a worker."""
    send_tensors_by_value()
    return step(piece, *more)


def _lost(step: Callable[..., Any], piece: Piece, *_: Any) -> Entry:
    return lost(piece)


def _observe(piece: Piece, grid_height: int, specular: bool) -> Entry | Observed:
    """Everything that comes before the light."""
    begun = time.perf_counter()
    sha256 = photo_hash(piece.path)

    def seen() -> tuple[Pictures, tuple[SeenFace, ...]]:
        pictures = piece.pictures()
        return pictures, tuple(pictures.observe(pictures.fit_heads(), grid_height, specular))

    found, error = piece.attempt(seen)
    seconds = time.perf_counter() - begun
    if found is None:
        return piece.entry(sha256, seconds, None, error)
    pictures, faces = found
    return Observed(
        piece=piece,
        sha256=sha256,
        seen=faces,
        left_out=pictures.left_out,
        sun_prior=pictures.sun_prior,
        exposure=pictures.exposure,
        stages=pictures.seconds,
        seconds=seconds,
    )


def _lights(
    batch: Sequence[Observed], settings: EstimateSettings
) -> list[tuple[Estimate | None, str]]:
    """(the light, "") of each photo, or (None, why there is none).

    On the CPU by one thread, as workers have: where a descent ends, depends on its rounding.
    """
    threads = torch.get_num_threads()
    if choose_device(settings.device).type == "cpu":
        torch.set_num_threads(1)
    try:
        if len(batch) > 1:
            try:
                return [(light, "") for light in _solve(batch, settings)]
            except Exception as fault:  # of one of them, or of memory that does for one
                logging.getLogger(__name__).warning(
                    "skylight: %d photos could not be solved together (%s: %s); each is solved by "
                    "itself",
                    len(batch),
                    type(fault).__name__,
                    str(fault).partition("\n")[0],
                )
        return [one.piece.attempt(lambda one=one: _solve([one], settings)[0]) for one in batch]
    finally:
        torch.set_num_threads(threads)


def _solve(batch: Sequence[Observed], settings: EstimateSettings) -> list[Estimate]:
    problems = settings.problems([one.sun_prior for one in batch], [one.exposure for one in batch])
    for problem, one in zip(problems, batch, strict=True):
        for face in one.seen:
            problem.add(face.view.observation)
    return solve(problems)


def _solved(one: Observed, seconds: float) -> Observed:
    """Without the transport that has served, and with what its light took."""
    return replace(
        one,
        seen=tuple(face.on_fewer_rows() for face in one.seen),
        stages={**one.stages, STAGES[3]: seconds},
        seconds=one.seconds + seconds,
    )


def _write(piece: Piece, observed: Observed, light: Estimate) -> Entry:
    """The results of a photo, which is read again."""
    begun = time.perf_counter()

    def written() -> PhotoEstimate:
        before = {"left_out": observed.left_out, "seconds": observed.stages}
        return replace(piece.pictures(), **before).result(light, observed.seen)

    content, error = piece.attempt(lambda: piece.write(written))
    seconds = observed.seconds + time.perf_counter() - begun
    return piece.entry(observed.sha256, seconds, content, error)
