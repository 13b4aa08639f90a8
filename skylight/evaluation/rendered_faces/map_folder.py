"""Folders of environment maps whose light people are rendered under."""

import hashlib
import math
from dataclasses import dataclass
from pathlib import Path

from skylight.errors import InputError
from skylight.io.collection import names_categories, read_categories
from skylight.io.files import read_environment_map
from skylight.io.hdr import SUFFIXES
from skylight.io.listing import visible_files
from skylight.sphere.envmap import EnvironmentMap

ROWS = 64  # of the light of a rendered face


@dataclass(frozen=True, kw_only=True)
class TurnedMap:
    """Which map lights a scene: its ``file``, turned about the vertical by ``turn_deg``.

    ``category`` is that of the folder's ``index.csv``, None where it names none.
    """

    file: str
    category: str | None
    turn_deg: float


@dataclass(frozen=True, kw_only=True)
class MapFolder:
    """The maps of ``folder``, sorted by name; ``sha256`` is of their names and bytes."""

    folder: Path
    files: tuple[str, ...]
    categories: tuple[str | None, ...]
    sha256: str

    @staticmethod
    def read(folder: Path) -> "MapFolder":
        """Every .exr and .hdr file in it, each a usable map of the whole sphere.

        Raises
        ------
        InputError
            No such folder, no maps in it, or one that is damaged, a sky alone or black.
        """
        if not folder.is_dir():
            raise InputError(f"{folder}: there is no such folder; give one with lat-long maps")
        files = tuple(path.name for path in visible_files(folder, SUFFIXES))
        if not files:
            raise InputError(f"{folder}: no maps in it; put .exr or .hdr lat-long maps there")
        digest = hashlib.sha256()
        for file in files:
            read_light(folder / file)
            content = hashlib.sha256((folder / file).read_bytes()).hexdigest()
            digest.update(f"{file} {content}\n".encode())
        listed = read_categories(folder) if names_categories(folder) else {}
        return MapFolder(
            folder=folder,
            files=files,
            categories=tuple(listed.get(file) for file in files),
            sha256=digest.hexdigest(),
        )

    def turned(self, number: int, turn_rad: float) -> tuple[EnvironmentMap, TurnedMap]:
        """Map ``number`` modulo their count, turned to the right in the image, 64 x 128.

        The energy of the map is kept: it is turned by interpolating within its rows, and each
        pixel of the result is the mean of the solid angle that it covers.
        """
        index = number % len(self.files)
        light = read_light(self.folder / self.files[index])
        which = TurnedMap(
            file=self.files[index],
            category=self.categories[index],
            turn_deg=math.degrees(turn_rad),
        )
        return light.rotate_azimuth(turn_rad).resize(ROWS), which


def read_light(path: Path) -> EnvironmentMap:
    """A map of the whole sphere that gives light.

    Raises
    ------
    InputError
        As :func:`read_environment_map`; a sky alone; a map that is black.
    """
    light = read_environment_map(path)
    if light.is_sky:
        raise InputError(f"{path}: shows the sky alone; give maps of the whole sphere (w = 2 h)")
    if not light.radiance.any():
        raise InputError(f"{path}: is black all over and lights nothing; take it out of the folder")
    return light
