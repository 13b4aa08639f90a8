"""Environment maps and images: strict reading, atomic writing, and folders of them.

A file that cannot be used is refused in one line that names it. A folder of maps may have an
``index.csv`` of files and categories.
"""

import csv
from collections.abc import Collection
from io import StringIO
from pathlib import Path

import numpy as np
import OpenEXR
import torch
from jaxtyping import Float, UInt8
from PIL import Image
from torch import Tensor

from skylight.errors import InputError, OutputError
from skylight.io._atomic import atomic_path
from skylight.io._bounded import file_text
from skylight.io._hdr import HALF_MAX, RGBE_MAX, check_suffix, write_exr, write_radiance
from skylight.io._light import fault, read_latlong, read_radiances
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import Convention, convert_latlong


def read_environment_map(
    path: str | Path,
    *,
    convention: Convention = "skylight",
    layer: str | None = None,
    repair: bool = False,
) -> EnvironmentMap:
    """Light from an .exr, Radiance (.hdr, .pic) or float .tif lat-long file, in skylight's frame.

    Parameters
    ----------
    path
        A full map (width = 2 height) or an upper-hemisphere sky (width = 4 height).
    convention
        Where the file's columns look: see :data:`skylight.sphere._frame.Convention`.
    layer
        Of an .exr file with several layers or parts, the name of one.
    repair
        Replace a few values that are infinite, NaN or a little below 0: see
        :func:`skylight.io._light.read_radiances`.

    Raises
    ------
    InputError
        A missing or damaged file, another shape, or values that are NaN, negative or infinite.
    """
    pixels = torch.from_numpy(read_latlong(Path(path), layer=layer, repair=repair))
    return EnvironmentMap(radiance=convert_latlong(pixels, convention, "skylight"))


def read_light(
    path: Path, *, layer: str | None = None, repair: bool = False
) -> Float[Tensor, "h w 3"]:
    """Linear radiance from a file of any shape; otherwise as :func:`read_environment_map`."""
    return torch.from_numpy(read_radiances(path, layer=layer, repair=repair))


def write_environment_map(
    path: str | Path,
    environment: EnvironmentMap,
    *,
    half: bool = False,
    convention: Convention = "skylight",
    header: dict[str, object] | None = None,
) -> None:
    """Write a map as .exr (single precision, or half) or .hdr (RGBE), laid out as asked.

    An .exr carries the Rec.709 chromaticities and, for a full map, the standard ``envmap``
    attribute. That attribute names the projection; the orientation is OpenEXR's own only where
    ``convention`` is "openexr", so a comment in the header names it. ``header`` has further
    attributes of an .exr (see OpenEXR).

    Raises
    ------
    OutputError
        Values that no reader should meet (NaN, negative, infinite, too large for the format),
        or a disk that does not take the file. A file that was there before is left as it was.
    """
    header = {"comments": f"lat-long, {convention} convention"} | (header or {})
    if not environment.is_sky:
        header["envmap"] = OpenEXR.ENVMAP_LATLONG
    picture = convert_latlong(environment.radiance, "skylight", convention)
    write_light(path, picture, header=header, half=half)


def write_light(
    path: str | Path,
    picture: Float[Tensor, "h w 3"],
    *,
    header: dict[str, object],
    half: bool = False,
) -> None:
    """Write linear Rec.709 radiance as .exr, with ``header`` (see OpenEXR), or as .hdr.

    Raises
    ------
    InputError, OutputError
        As :func:`write_environment_map`.
    """
    path = Path(path)
    check_suffix(path)
    is_exr = path.suffix.lower() == ".exr"
    if half and not is_exr:
        raise InputError(f"{path}: half precision is a choice for .exr; RGBE has one precision")
    pixels = _float_pixels(picture)
    told = fault(pixels)
    if told:
        raise OutputError(f"{path} was not written: {told}")
    limit = (HALF_MAX if half else np.inf) if is_exr else RGBE_MAX
    if pixels.max() > limit:
        raise OutputError(
            f"{path} was not written: the brightest value {pixels.max():.6g} exceeds the format's "
            f"largest, {limit:.6g}; write single-precision .exr (half=False) or scale the map down"
        )
    with atomic_path(path) as temporary:
        if is_exr:
            write_exr(temporary, pixels, half=half, header=header)
        else:
            write_radiance(temporary, pixels)


def write_png(path: str | Path, rgb: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write an 8-bit picture."""
    with atomic_path(path) as temporary:
        Image.fromarray(np.ascontiguousarray(rgb)).save(temporary, format="PNG")


def _float_pixels(radiance: Float[Tensor, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    return np.ascontiguousarray(radiance.detach().to("cpu", torch.float32).numpy())


def visible_files(
    folder: Path, suffixes: Collection[str] | None, *, recursive: bool = False
) -> list[Path]:
    """Files in ``folder``, or below it, whose suffix in lower case is one of ``suffixes``; sorted.

    None stands for all suffixes.

    Hidden ones and those in hidden folders are left out: so are called what a run that was killed
    left half written (:func:`skylight.io._atomic.atomic_path`), and what systems put beside
    pictures (``._me.jpg``).
    """
    return sorted(
        path
        for path in (folder.rglob("*") if recursive else folder.iterdir())
        if (suffixes is None or path.suffix.lower() in suffixes)
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
        and path.is_file()
    )


INDEX_NAME = "index.csv"
_COLUMNS = ("file", "category")


def names_categories(folder: Path) -> bool:
    """Whether the folder has an ``index.csv`` whose first line names file and category.

    Raises
    ------
    InputError
        There is one that is damaged.
    """
    path = folder / INDEX_NAME
    if not path.is_file():
        return False
    try:
        text = file_text(path)
        if not text.strip("\0\r\n "):  # also what a crash leaves of a file
            raise ValueError("it is empty")
        return set(_COLUMNS) <= set(next(csv.reader(StringIO(text, newline=""))))
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(
            f"{path}: cannot be read as CSV ({error}); mend it, or move it away"
        ) from error


def read_categories(folder: Path) -> dict[str, str]:
    """File -> category, in the order of the index.

    Raises
    ------
    InputError
        No readable ``index.csv`` with the columns file and category.
    """
    path = folder / INDEX_NAME
    try:
        reader = csv.DictReader(StringIO(file_text(path), newline=""))
        if not set(_COLUMNS) <= set(reader.fieldnames or ()):
            raise ValueError("its first line names others")
        rows = list(reader)
        if any(row["file"] is None or row["category"] is None for row in rows):
            raise ValueError("a row is too short")
        return {row["file"]: row["category"] for row in rows}
    except (OSError, KeyError, ValueError, csv.Error) as error:
        raise InputError(
            f"{path}: cannot be read as an index of maps with columns file and category ({error}); "
            "mend it, or move it away"
        ) from error
