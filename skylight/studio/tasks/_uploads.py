"""Uploaded photographs and environment maps: checked, read, previewed.

The number of pixels is read from a file's header, before anything is decoded.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypedDict

import OpenEXR
from PIL import Image

from skylight.errors import DependencyError, InputError
from skylight.faces._landmarkers import choose_landmarker
from skylight.faces._landmarks import DetectedFace
from skylight.imaging._photo import Photo, read_photo
from skylight.imaging._pictures import picture_size
from skylight.io._atomic import atomic_path
from skylight.io._files import read_environment_map
from skylight.io._hdr import RADIANCE_SUFFIXES
from skylight.io._muted import muted
from skylight.io._radiance import radiance_size
from skylight.sphere._envmap import EnvironmentMap
from skylight.work._progress import StageProgress

PREVIEW_PX = 1600  # longest side
_QUALITY = 88


def see_photo(
    path: str, name: str, preview: str, pixels: int, *, tell: StageProgress
) -> dict[str, Any]:
    """Size of the preview, which is written, and the faces in it, the largest first."""
    tell("reading the picture", 0.0)
    photo = open_photo(Path(path), name, pixels)
    tell("finding faces", 0.3)
    faces = choose_landmarker().detect(photo.encoded)
    scale = preview_scale(photo)
    height, width = photo.encoded.shape[:2]
    size = (max(1, round(scale * width)), max(1, round(scale * height)))
    with atomic_path(Path(preview)) as temporary:
        small = Image.fromarray(photo.encoded).resize(size, Image.Resampling.LANCZOS)
        small.save(temporary, format="JPEG", quality=_QUALITY)
    return {
        "width": size[0],
        "height": size[1],
        "faces": [
            {"number": number, "box": _box(face, scale)} for number, face in enumerate(faces, 1)
        ],
    }


def open_photo(path: Path, name: str, pixels: int) -> Photo:
    """The uploaded photograph, called by the user's name for it in errors."""
    with named(path, name):
        check_pixels(path, pixels)
        return read_photo(path)


def preview_scale(photo: Photo) -> float:
    """Pixels of the preview over pixels of the photograph, 1 at most."""
    return min(1.0, PREVIEW_PX / max(photo.encoded.shape[:2]))


def see_map(path: str, name: str, pixels: int, *, tell: StageProgress) -> dict[str, Any]:
    """Size of a map of light of the whole sphere."""
    tell("reading the map", 0.0)
    with named(Path(path), name):
        check_pixels(Path(path), pixels)
        environment = read_environment_map(path)
        height, width = environment.layout
        if environment.is_sky:
            raise InputError(
                f"{path}: {width}x{height} is the upper half of a map; give one of the whole "
                "sphere, whose width is 2 heights"
            )
    return {"width": width, "height": height}


class Light(TypedDict):
    """Where its file is, and what the user calls it."""

    path: str
    name: str


def read_light(light: Light) -> EnvironmentMap:
    """The map of the whole sphere."""
    path = Path(light["path"])
    with named(path, light["name"]):
        return read_environment_map(path)


@contextmanager
def named(path: Path, name: str) -> Iterator[None]:
    """Errors within tell the user's name for a file instead of the path where it was put."""
    try:
        yield
    except InputError as error:
        raise InputError(str(error).replace(str(path), name)) from error


def _box(face: DetectedFace, scale: float) -> list[int]:
    """[x, y, width, height] of the landmarks, in pixels of the preview."""
    low, high = scale * face.points.min(0), scale * face.points.max(0)
    x, y = (math.floor(side) for side in low)
    return [x, y, math.ceil(high[0]) - x, math.ceil(high[1]) - y]


def check_pixels(path: Path, most: int) -> None:
    """:class:`InputError` where a picture's header tells of more than ``most`` pixels.

    A file without a readable header passes: the reader will say what is wrong with it.
    """
    count = pixel_count(path)
    if count is not None and count > most:
        raise InputError(
            f"{path}: {count / 1e6:.3g} million pixels, {most / 1e6:.3g} at most; scale it down"
        )


def pixel_count(path: Path) -> int | None:
    """Width times height of an .exr (all its parts), .hdr or other picture; None if unknown."""
    suffix = path.suffix.lower()
    if suffix == ".exr":
        return _of_exr(path)
    if suffix in RADIANCE_SUFFIXES:
        try:
            return math.prod(radiance_size(path.read_bytes()))
        except ValueError:
            return None
    try:
        width, height = picture_size(path)
        return width * height
    except (InputError, DependencyError):
        return None


def _of_exr(path: Path) -> int | None:
    try:
        with muted():
            parts = OpenEXR.File(str(path), header_only=True).parts
        windows = [part.header["dataWindow"] for part in parts]
    except (RuntimeError, KeyError, ValueError, TypeError):
        return None
    return sum((int(x1) - int(x0) + 1) * (int(y1) - int(y0) + 1) for (x0, y0), (x1, y1) in windows)
