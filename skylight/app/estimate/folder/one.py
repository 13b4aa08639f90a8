"""One photograph of a folder: its results, and its line of the manifest."""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from skylight.app.estimate.folder.listing import folder_name, photo_hash
from skylight.app.estimate.folder.manifest import Entry
from skylight.app.estimate.folder.settings import BatchSettings
from skylight.errors import DependencyError, InputError, SkylightError
from skylight.faces.detection.landmarkers import choose_landmarker

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
    from skylight.app.estimate.photos import estimate_photo
    from skylight.app.estimate.results import MESHES, write_results
    from skylight.imaging.photo import read_photo
    from skylight.work.results_folder import results_folder

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
