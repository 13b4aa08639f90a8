"""Options of several commands: workers or a cluster, sources of pictures, capture metadata."""

from __future__ import annotations

import sys
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from skylight._names import PLACES, Place
from skylight.errors import InputError
from skylight.imaging._capture_metadata import CaptureMetadata
from skylight.work._threads import cores

if TYPE_CHECKING:
    from skylight.work._resumable import Workers


def who_works(workers: int, cluster: str | None, out: Path) -> Workers:
    """So many processes here, 0 for one per core, or those of the cluster for ``out``."""
    if cluster is not None:
        if workers != 0:
            raise InputError(
                "--workers and --cluster contradict each other: a cluster has its own workers"
            )
        from skylight.work._cluster import Cluster

        return Cluster(address=cluster, folder=out)
    if workers < 0:
        raise InputError(f"--workers must be 0 or more, got {workers}")
    return workers or cores()


def one_source(
    photos: tuple[Path, ...], video: Path | None, webcam: int | None
) -> tuple[Path, ...] | Path | int:
    """Photographs, a film's file or a camera's number: whichever the command line gives."""
    given = [each for each in (photos or None, video, webcam) if each is not None]
    if len(given) != 1:
        raise InputError("give photos, --video or --webcam, and only one of them")
    return given[0]


def film_source(video: Path | None, webcam: int | None) -> Path | int:
    """A film's file or a camera's number: whichever the command line gives."""
    if video is not None and webcam is None:
        return video
    if webcam is not None and video is None:
        return webcam
    raise InputError("give --video or --webcam, and only one of them")


def take_care(line: str) -> None:
    """Print a warning on standard error; the results are written all the same."""
    print(f"skylight: take care: {line}", file=sys.stderr)


def kind_of_place(place: str | None) -> tuple[Place, str | None]:
    """(kind, where) of ``--place``: "outdoors", "41.89,12.49", or "outdoors,41.89,12.49"."""
    first, _, where = (place or "").partition(",")
    for kind in PLACES:
        if first == kind:
            return kind, where or None
    return "auto", place


def taken_by_hand(
    time: str | None, place: str | None, heading: float | None
) -> CaptureMetadata | None:
    """The capture metadata of ``--time``, ``--place`` and ``--heading``, None without any."""
    if time is None and place is None and heading is None:
        return None
    latitude_deg, longitude_deg = (None, None) if place is None else _place(place)
    return CaptureMetadata(
        time=None if time is None else _time(time),
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        heading_deg=heading,
    )


def _time(text: str) -> datetime:
    try:
        time = datetime.fromisoformat(text)
    except ValueError as error:
        raise InputError(
            f"--time {text!r} is no time; write it as 2024-06-01T14:30+02:00"
        ) from error
    if time.tzinfo is None:
        raise InputError(f"--time {text!r} has no time zone; end it with one, as +02:00, or Z")
    return time


def _place(text: str) -> tuple[float, float]:
    try:
        latitude, longitude = text.split(",")
        return float(latitude), float(longitude)
    except ValueError as error:
        raise InputError(
            f"--place {text!r} is no place; give degrees north and east as 41.89,12.49, or "
            f"one of {', '.join(PLACES)}"
        ) from error
