"""Uploaded photographs and environment maps: checked, read, previewed."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image

from skylight.errors import InputError
from skylight.faces.detection.landmarkers import choose_landmarker
from skylight.faces.landmarks import DetectedFace
from skylight.imaging.photo import Photo, read_photo
from skylight.io.atomic import atomic_path
from skylight.io.files import read_environment_map
from skylight.studio.tasks.picture_headers import check_pixels
from skylight.work.progress import StageProgress

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
