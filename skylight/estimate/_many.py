"""One photograph of a folder: its results, and its line of the manifest.

Photographs of a folder whose lights are found together, on one device.
"""

import json
import logging
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import torch

from skylight.errors import DependencyError, InputError, SkylightError
from skylight.estimate._manifest import BatchSettings, Entry, folder_name, photo_hash
from skylight.estimate._pictures import STAGES, Pictures
from skylight.estimate._report import MESHES, write_results
from skylight.estimate._summary import SeenFace
from skylight.faces._landmarkers import choose_landmarker
from skylight.imaging._photo import read_photo
from skylight.inverse._estimate import light_problem, light_problems, solve_each
from skylight.inverse._result import Estimate
from skylight.inverse._sky import SOLVERS
from skylight.inverse._sun_prior import SunPrior
from skylight.models._bundle import LightBundle, load_bundle
from skylight.work._device import choose_device
from skylight.work._processes import send_tensors_by_value
from skylight.work._resumable import results_folder, share_work

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Piece:
    """A photo of the folder ``photos``, whose results go below ``out``.

    ``settings_hash`` is that of what the manifest says about the settings.
    """

    photos: Path
    source: str
    out: Path
    settings: BatchSettings
    settings_hash: str

    @property
    def path(self) -> Path:
        return self.photos / self.source

    @property
    def folder(self) -> Path:
        return self.out / folder_name(self.source)

    def done(self, sha256: str | None, seconds: float, told: dict[str, Any]) -> Entry:
        """With what its estimate.json says."""
        return Entry(
            source=self.source,
            sha256=sha256,
            settings=self.settings_hash,
            status="done",
            seconds=round(seconds, 3),
            results=folder_name(self.source),
            sun=told["sun"],
            verdict=told["posterior"]["verdict"],
            advice=told["advice"],
            versions=told["versions"],
        )

    def failed(self, sha256: str | None, seconds: float | None, error: str) -> Entry:
        """With one line that says why."""
        return Entry(
            source=self.source,
            sha256=sha256,
            settings=self.settings_hash,
            status="failed",
            error=error,
            seconds=None if seconds is None else round(seconds, 3),
        )

    def attempt(self, work: Callable[[], T]) -> tuple[T | None, str]:
        """(what ``work`` makes, ""), or (None, the photo's error in one line).

        Raises
        ------
        OutputError, AssetError
            What would be wrong with every photo: a full disk, a damaged installation.
        """
        try:
            return work(), ""
        except (InputError, DependencyError) as fault:
            error = str(fault).replace(str(self.path), self.source)
        except SkylightError:
            raise
        except Exception as fault:
            first = str(fault).partition("\n")[0]
            error = f"{self.source}: internal error ({type(fault).__name__}: {first})"
        return None, " ".join(error.split())


def estimate_one(piece: Piece) -> Entry:
    """One photo, in a worker: its results, and what the manifest says of it.

    Raises
    ------
    OutputError, AssetError
        As :meth:`Piece.attempt`.
    """
    begun = time.perf_counter()
    sha256 = photo_hash(piece.path)
    told, error = piece.attempt(lambda: _estimate_into(piece))
    seconds = time.perf_counter() - begun
    if told is None:
        return piece.failed(sha256, seconds, error)
    return piece.done(sha256, seconds, told)


def lost(piece: Piece) -> Entry:
    """Of a photo that no worker survived."""
    return piece.failed(
        photo_hash(piece.path),
        None,
        f"{piece.source}: its workers were killed again and again, so memory may be short: try "
        "again with --retry-failed and fewer workers, or more memory for each",
    )


def _estimate_into(piece: Piece) -> dict[str, Any]:
    """Estimate a photo and write its results; what estimate.json says."""
    # torch takes 2 s to import, which whoever only shares out photos does not wait for
    from skylight.estimate._photos import estimate_photo
    from skylight.estimate._report import MESHES, write_results
    from skylight.imaging._photo import read_photo
    from skylight.work._resumable import results_folder

    settings = piece.settings
    photo = read_photo(piece.path, decode=settings.decode)
    with results_folder(piece.folder, MESHES) as folder:
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
            names=[piece.source],
            workers=1,
        )
        write_results(folder, result, keep_place=settings.keep_place)
        return read_told(folder)


def read_told(folder: Path) -> dict[str, Any]:
    """What estimate.json says."""
    return json.loads((folder / "estimate.json").read_text(encoding="utf-8"))


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
    that the photo gets by itself but for rounding (:func:`~skylight.inverse._estimate.solve_each`),
    and everything else is the same.

    What fails with one photo is its entry: where a batch cannot be solved, each of it is solved by
    itself. At Ctrl-C results that are being written are finished, and come before the interrupt.

    Memory: 60 MB for each face of a batch, and what
    :func:`~skylight.inverse._sky.solve_together` says, on the device.

    Raises
    ------
    OutputError, AssetError
        As :meth:`~skylight.estimate._many.Piece.attempt`.
    """
    if not pieces:
        return
    send_tensors_by_value()
    settings = pieces[0].settings
    model = None if settings.model is None else load_bundle(settings.model)
    needs = light_problem(settings.light, model=model, device=settings.device)
    queue: deque[tuple] = deque(
        (_observe, piece, needs.grid_height, needs.uses_gloss) for piece in pieces
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
                lights = _lights(waiting, model)
            except KeyboardInterrupt as interrupt:
                yield from _finished(stream, interrupt)
                raise
            share = (time.perf_counter() - begun) / len(waiting)
            for one, (light, error) in zip(waiting, lights, strict=True):
                if light is None:
                    yield one.piece.failed(one.sha256, one.seconds + share, error)
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


def _observe(piece: Piece, grid_height: int, gloss: bool) -> Entry | Observed:
    """Everything that comes before the light."""
    begun = time.perf_counter()
    sha256 = photo_hash(piece.path)

    def seen() -> tuple[Pictures, tuple[SeenFace, ...]]:
        settings, pictures = piece.settings, _pictures(piece)
        fitted = pictures.fit_heads(
            settings.face, settings.head, choose_landmarker(settings.landmarks)
        )
        faces = pictures.observe(fitted, grid_height=grid_height, gloss=gloss, workers=1)
        return pictures, tuple(faces)

    found, error = piece.attempt(seen)
    seconds = time.perf_counter() - begun
    if found is None:
        return piece.failed(sha256, seconds, error)
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


def _pictures(piece: Piece) -> Pictures:
    settings = piece.settings
    return Pictures.of(
        [read_photo(piece.path, decode=settings.decode)],
        settings.light,
        names=[piece.source],
        ignore_exif_sun=settings.ignore_exif_sun,
    )


def _lights(
    batch: Sequence[Observed], model: LightBundle | None
) -> list[tuple[Estimate | None, str]]:
    """(the light, "") of each photo, or (None, why there is none).

    On the CPU by one thread, as workers have: where a descent ends, depends on its rounding.
    """
    threads = torch.get_num_threads()
    if choose_device(batch[0].piece.settings.device).type == "cpu":
        torch.set_num_threads(1)
    try:
        if len(batch) > 1:
            try:
                return [(light, "") for light in _solve(batch, model)]
            except Exception as fault:  # of one of them, or of memory that does for one
                logging.getLogger(__name__).warning(
                    "skylight: %d photos could not be solved together (%s: %s); each is solved by "
                    "itself",
                    len(batch),
                    type(fault).__name__,
                    str(fault).partition("\n")[0],
                )
        return [one.piece.attempt(lambda one=one: _solve([one], model)[0]) for one in batch]
    finally:
        torch.set_num_threads(threads)


def _solve(batch: Sequence[Observed], model: LightBundle | None) -> list[Estimate]:
    settings = batch[0].piece.settings
    problems = light_problems(
        len(batch),
        settings.light,
        model=model,
        options=replace(SOLVERS[settings.solver], ground=settings.ground),
        sun_priors=[one.sun_prior for one in batch],
        exposures=[one.exposure for one in batch],
        device=settings.device,
    )
    for problem, one in zip(problems, batch, strict=True):
        for face in one.seen:
            problem.add(face.view.observation)
    return solve_each(problems)


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

    def written() -> dict[str, Any]:
        pictures = replace(_pictures(piece), left_out=observed.left_out, seconds=observed.stages)
        with results_folder(piece.folder, MESHES) as folder:
            result = pictures.result(light, observed.seen)
            write_results(folder, result, keep_place=piece.settings.keep_place)
            return read_told(folder)

    told, error = piece.attempt(written)
    seconds = observed.seconds + time.perf_counter() - begun
    if told is None:
        return piece.failed(observed.sha256, seconds, error)
    return piece.done(observed.sha256, seconds, told)
