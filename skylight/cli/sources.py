"""Sources of pictures, and messages about them."""

import sys
from pathlib import Path

from skylight.errors import InputError


def one_source(
    photos: tuple[Path, ...], video: Path | None, webcam: int | None
) -> tuple[Path, ...] | Path | int:
    """The one that was given."""
    given = [each for each in (photos or None, video, webcam) if each is not None]
    if len(given) != 1:
        raise InputError("give photos, --video or --webcam, and only one of them")
    return given[0]


def film_source(video: Path | None, webcam: int | None) -> Path | int:
    """The one that was given."""
    if video is not None and webcam is None:
        return video
    if webcam is not None and video is None:
        return webcam
    raise InputError("give --video or --webcam, and only one of them")


def take_care(line: str) -> None:
    """A doubt, on standard error; the results are there all the same."""
    print(f"skylight: take care: {line}", file=sys.stderr)
