"""Which files show one direction: folders of pictures, or a row of equal brackets."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from skylight.errors import InputError
from skylight.imaging._photo import PHOTO_SUFFIXES
from skylight.io._files import visible_files
from skylight.io._hdr import SUFFIXES as HDR_SUFFIXES
from skylight.probes.cameras._exposure_files import exif_exposures, exposure_times
from skylight.probes.panorama._panorama import rotation_to

_ALIKE = 0.05  # relative difference of two exposure times that are meant to be the same
_COLUMNS = ("azimuth_deg", "elevation_deg")


@dataclass(frozen=True, kw_only=True)
class Bracket:
    """The exposures of one direction; ``seconds`` is None for a file that was merged already."""

    files: tuple[Path, ...]
    seconds: tuple[float, ...] | None


def find_brackets(
    sources: Sequence[Path], times: str | None, size: int | None
) -> tuple[Bracket, ...]:
    """The shots of a folder, of several, or of files in the order in which they were taken.

    ``sources``: a folder with a folder for each direction; a folder with all files, in the order of
    their names; several folders, one for each direction; or files.
    ``times``: exposure times of one direction, the same for all; by default EXIF data tell.
    ``size``: exposures of one direction; by default as many as there are different times.
    """
    groups = _folders(sources)
    if groups is None:
        files = _files(sources)
        merged = [path.suffix.lower() in HDR_SUFFIXES for path in files]
        if all(merged) and times is None:
            return tuple(Bracket(files=(path,), seconds=None) for path in files)
        given = None if times is None else exposure_times(times)
        seconds = _seconds(files, given, size)
        size = size or (len(given) if given is not None else _different(seconds))
        if len(files) % size:
            raise InputError(
                f"{len(files)} pictures are no whole number of brackets of {size}: see that none "
                "is missing, or give --bracket, or put each direction into a folder of its own"
            )
        groups = [files[k : k + size] for k in range(0, len(files), size)]
        parts = [tuple(seconds[k : k + size]) for k in range(0, len(files), size)]
        brackets = [
            Bracket(files=tuple(group), seconds=part)
            for group, part in zip(groups, parts, strict=True)
        ]
    else:
        brackets = _of_folders(groups, times)
    for bracket in brackets:
        if bracket.seconds is not None and _different(bracket.seconds) < len(bracket.seconds):
            raise InputError(
                f"{bracket.files[0]} to {bracket.files[-1].name}: two of these "
                f"{len(bracket.files)} have the same exposure, so they are not one direction: see "
                "that none is missing, or put each direction into a folder of its own"
            )
    return tuple(brackets)


def read_turns(path: Path, count: int) -> dict[int, Float[np.ndarray, "3 3"]]:
    """World from camera of each shot, by a table of azimuth_deg and elevation_deg.

    Azimuth 0 becomes the map's middle, + is to the right; elevation + is up. A row for each
    direction, in the order of the shots; an empty one for a direction that is not known. Empty
    rows beyond the last direction do not count.
    """
    try:
        # Excel begins its UTF-8 with a byte order mark
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = list(csv.reader(file, skipinitialspace=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot read {path} ({error}); give a table as CSV") from error
    if not lines or not set(_COLUMNS) <= set(lines[0]):
        raise InputError(f"{path}: it needs the columns {' and '.join(_COLUMNS)}")
    rows = [dict(zip(lines[0], line, strict=False)) for line in lines[1:]]
    while len(rows) > count and not any(rows[-1].values()):
        rows.pop()
    if len(rows) != count:
        raise InputError(f"{path}: {len(rows)} rows for {count} directions: give one each")
    turns = {}
    for number, row in enumerate(rows):
        stated = [row.get(name, "").strip() for name in _COLUMNS]
        if not any(stated):
            continue
        try:
            azimuth, elevation = map(float, stated)
        except ValueError as error:
            raise InputError(f"{path}, row {number + 1}: {error}; give degrees") from error
        if not (abs(azimuth) <= 720 and abs(elevation) <= 90):
            raise InputError(
                f"{path}, row {number + 1}: {azimuth:g}, {elevation:g} is no direction; elevations "
                "are -90 to 90 degrees"
            )
        turns[number] = rotation_to(azimuth, elevation)
    return turns


def _folders(sources: Sequence[Path]) -> list[list[Path]] | None:
    """Pictures of each direction's folder; None where they are all in one row."""
    if not sources:
        raise InputError("no shots were given: name a folder, or files")
    folders = [path for path in sources if path.is_dir()]
    if not folders:
        return None
    if len(folders) < len(sources):
        raise InputError("give folders or files, not both")
    if len(folders) == 1:
        inner = sorted(p for p in folders[0].iterdir() if p.is_dir() and p.name[0] != ".")
        inner = [folder for folder in inner if visible_files(folder, PHOTO_SUFFIXES)]
        loose = visible_files(folders[0], PHOTO_SUFFIXES)
        if loose and inner:
            raise InputError(
                f"{folders[0]}: it holds pictures ({loose[0].name}) and folders of pictures "
                f"({inner[0].name}): move one or the other elsewhere"
            )
        if loose:
            return None
        folders = inner
    groups = [visible_files(folder, PHOTO_SUFFIXES) for folder in folders]
    groups = [group for group in groups if group]
    if not groups:
        raise InputError(f"{sources[0]}: no pictures in it ({', '.join(sorted(PHOTO_SUFFIXES))})")
    return groups


def _files(sources: Sequence[Path]) -> list[Path]:
    return visible_files(sources[0], PHOTO_SUFFIXES) if sources[0].is_dir() else list(sources)


def _of_folders(groups: Sequence[Sequence[Path]], times: str | None) -> list[Bracket]:
    given = None if times is None else exposure_times(times)
    every = [path for group in groups for path in group]
    if given is None and all(path.suffix.lower() in HDR_SUFFIXES for path in every):
        counts = [len(group) for group in groups]
        if max(counts) == 1:
            return [Bracket(files=tuple(group), seconds=None) for group in groups]
        raise InputError(f"{every[0]}: it tells no exposure time; give --times")
    if given is None:
        stated = dict(zip(every, exif_exposures(every), strict=True))
        return [
            Bracket(files=tuple(group), seconds=tuple(stated[path] for path in group))
            for group in groups
        ]
    for group in groups:
        if len(group) != len(given):
            raise InputError(
                f"{group[0].parent}: {len(group)} pictures for {len(given)} exposure times"
            )
    return [Bracket(files=tuple(group), seconds=tuple(given)) for group in groups]


def _seconds(
    files: Sequence[Path], given: Sequence[float] | None, size: int | None
) -> Sequence[float]:
    """Of each file."""
    if given is None:
        return exif_exposures(files)
    if size is not None and size != len(given):
        raise InputError(f"--bracket {size} and {len(given)} --times: give one time for each")
    return [given[k % len(given)] for k in range(len(files))]


def _different(seconds: Sequence[float]) -> int:
    """How many different exposures there are."""
    logs = np.sort(np.log(seconds))
    return 1 + int((np.diff(logs) > _ALIKE).sum())
