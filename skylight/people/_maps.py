"""Folders of environment maps that light people.

Of simulated places (``skylight places simulate``) suns and lamps that are smaller than a pixel are
not in the maps: ``lights.csv`` beside them says where they stand and what energy they have.
"""

import csv
import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.io._bounded import file_text
from skylight.io._files import (
    INDEX_NAME,
    names_categories,
    read_categories,
    read_environment_map,
    visible_files,
)
from skylight.io._hdr import SUFFIXES
from skylight.places._simulated import LIGHTS_NAME, read_lights
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import direction_from_angles

ROWS = 64  # of the light of a rendered face


@dataclass(frozen=True, kw_only=True)
class TurnedMap:
    """Which map lights a scene: its ``file``, turned about the vertical by ``turn_deg``.

    ``category`` is that of the folder's ``index.csv``, or a place's kind; None where it names none.
    """

    file: str
    category: str | None
    turn_deg: float


@dataclass(frozen=True, kw_only=True)
class LightBeside:
    """A light that its map does not show, smaller than a pixel.

    ``energy`` is radiance times steradians in the map's units: the irradiance of what faces it.
    """

    kind: str
    azimuth_rad: float
    zenith_rad: float
    energy: Float[Tensor, "3"]

    @property
    def direction(self) -> Float[Tensor, "3"]:
        angles = self.azimuth_rad, self.zenith_rad
        return direction_from_angles(*(torch.tensor(a, dtype=torch.float64) for a in angles))

    def turned(self, turn_rad: float) -> "LightBeside":
        return LightBeside(
            kind=self.kind,
            azimuth_rad=self.azimuth_rad + turn_rad,
            zenith_rad=self.zenith_rad,
            energy=self.energy,
        )


@dataclass(frozen=True, kw_only=True)
class MapFolder:
    """The maps of ``folder``, sorted by name, and the lights that are not in them, by file.

    ``sha256`` is of names, bytes and lights.
    """

    folder: Path
    files: tuple[str, ...]
    categories: tuple[str | None, ...]
    sha256: str
    # the hash above stands for them
    beside: Mapping[str, tuple[LightBeside, ...]] = field(default_factory=dict, compare=False)

    @staticmethod
    def read(folder: Path) -> "MapFolder":
        """Every .exr and .hdr file in it, each a usable map of the whole sphere.

        Of simulated places those that their index lists.
        """
        if not folder.is_dir():
            raise InputError(f"{folder}: there is no such folder; give one with lat-long maps")
        files = tuple(path.name for path in visible_files(folder, SUFFIXES))
        kinds = _kinds(folder)
        if kinds is not None:  # lights of days that are not complete yet are listed nowhere
            files = tuple(file for file in files if file in kinds)
        if not files:
            raise InputError(f"{folder}: no maps in it; put .exr or .hdr lat-long maps there")
        beside = lights_beside(folder)
        digest = hashlib.sha256()
        for file in files:
            read_light(folder / file)
            content = hashlib.sha256((folder / file).read_bytes()).hexdigest()
            digest.update(f"{file} {content}\n".encode())
            for light in beside.get(file, ()):
                where = light.azimuth_rad, light.zenith_rad
                digest.update(f"{light.kind} {where} {light.energy.tolist()}\n".encode())
        listed = read_categories(folder) if names_categories(folder) else kinds or {}
        return MapFolder(
            folder=folder,
            files=files,
            categories=tuple(listed.get(file) for file in files),
            sha256=digest.hexdigest(),
            beside=beside,
        )

    def turned(
        self, number: int, turn_rad: float
    ) -> tuple[EnvironmentMap, TurnedMap, LightBeside | None]:
        """Map ``number`` modulo their count, turned to the right in the image, 64 x 128; its sun.

        The energy of the map is kept: it is turned by interpolating within its rows, and each
        pixel of the result is the mean of the solid angle that it covers. Lamps beside it are put
        into it; a sun is not.
        """
        index = number % len(self.files)
        file = self.files[index]
        light = read_light(self.folder / file).rotate_azimuth(turn_rad).resize(ROWS)
        sun = None
        for each in self.beside.get(file, ()):
            one = each.turned(turn_rad)
            if one.kind == "sun":
                sun = one
            else:
                light = light.with_light(one.direction, one.energy)
        which = TurnedMap(
            file=file, category=self.categories[index], turn_deg=math.degrees(turn_rad)
        )
        return light, which, sun


def read_light(path: Path) -> EnvironmentMap:
    """A map of the whole sphere that gives light."""
    light = read_environment_map(path)
    if light.is_sky:
        raise InputError(f"{path}: shows the sky alone; give maps of the whole sphere (w = 2 h)")
    if not light.radiance.any():
        raise InputError(f"{path}: is black all over and lights nothing; take it out of the folder")
    return light


def lights_beside(folder: Path) -> dict[str, tuple[LightBeside, ...]]:
    """By file, what simulated places have that is not in the map; {} of other maps."""
    path = folder / LIGHTS_NAME
    if not path.is_file():
        return {}
    return {
        file: tuple(
            LightBeside(
                kind=light.kind,
                azimuth_rad=math.radians(light.azimuth_deg),
                zenith_rad=math.radians(light.zenith_deg),
                energy=torch.tensor([light.red, light.green, light.blue]),
            )
            for light in lights
            if not light.in_map
        )
        for file, lights in read_lights(path).items()
    }


def _kinds(folder: Path) -> dict[str, str] | None:
    """File -> kind of place, where the folder is one of simulated places."""
    path = folder / INDEX_NAME
    if not path.is_file() or not (folder / LIGHTS_NAME).is_file():
        return None
    rows = csv.DictReader(StringIO(file_text(path), newline=""))
    if not {"file", "kind"} <= set(rows.fieldnames or ()):
        return None
    return {row["file"]: row["kind"] for row in rows}
