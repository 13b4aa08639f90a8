"""Photographs of a folder whose lights are found together, on one device."""

import logging
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch

from skylight.app.estimate.folder.listing import photo_hash
from skylight.app.estimate.folder.manifest import Entry
from skylight.app.estimate.folder.one import Piece, lost, read_told
from skylight.app.estimate.pictures import STAGES, Pictures
from skylight.app.estimate.results import MESHES, write_results
from skylight.app.estimate.types import SeenFace
from skylight.faces.detection.landmarkers import choose_landmarker
from skylight.imaging.photo import read_photo
from skylight.inverse.estimate import light_problem, light_problems, solve_each
from skylight.inverse.result import Estimate
from skylight.inverse.sky.solver import SOLVERS
from skylight.inverse.sun_prior import SunPrior
from skylight.models.bundle import LightBundle, load_bundle
from skylight.work.device import choose_device
from skylight.work.results_folder import results_folder
from skylight.work.resumable import share_work
from skylight.work.tensors_by_value import send_tensors_by_value


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
    that the photo gets by itself but for rounding (:func:`~skylight.inverse.estimate.solve_each`),
    and everything else is the same.

    What fails with one photo is its entry: where a batch cannot be solved, each of it is solved by
    itself. At Ctrl-C results that are being written are finished, and come before the interrupt.

    Memory: 60 MB for each face of a batch, and what
    :func:`~skylight.inverse.sky.problem.solve_together` says, on the device.

    Raises
    ------
    OutputError, AssetError
        As :meth:`~skylight.app.estimate.folder.one.Piece.attempt`.
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
