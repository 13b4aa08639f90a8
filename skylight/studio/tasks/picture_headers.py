"""Image dimensions from headers, before decoding."""

from pathlib import Path

import OpenEXR

from skylight.errors import InputError
from skylight.io.hdr import muted, radiance_sizes
from skylight.io.opened_picture import opened_picture


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
    if suffix == ".hdr":
        sizes = radiance_sizes(path.read_bytes())
        return max((abs(height * width) for height, width in sizes), default=None)
    try:
        with opened_picture(path) as image:
            return image.width * image.height
    except InputError:
        return None


def _of_exr(path: Path) -> int | None:
    try:
        with muted():
            parts = OpenEXR.File(str(path), header_only=True).parts
        windows = [part.header["dataWindow"] for part in parts]
    except (RuntimeError, KeyError, ValueError, TypeError):
        return None
    return sum((int(x1) - int(x0) + 1) * (int(y1) - int(y0) + 1) for (x0, y0), (x1, y1) in windows)
