"""Light from files, checked, and repaired where that is asked for; without torch."""

import logging
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float

from skylight.errors import InputError
from skylight.io._exr import read_exr
from skylight.io._hdr import HALF_MAX, RADIANCE_SUFFIXES
from skylight.io._radiance import read_radiance
from skylight.io._tiff import read_tiff

_TIFF_SUFFIXES = (".tif", ".tiff")
READ_SUFFIXES = (".exr", *RADIANCE_SUFFIXES, *_TIFF_SUFFIXES)
_REPAIRED_MOST = 0.05  # share of the pixels; more is no map with faults but another thing
_SMALL = 0.1  # of a negative value, over the largest of its pixel or the mean of the map


def read_linear(path: Path, *, layer: str | None = None) -> Float[np.ndarray, "h w 3"]:
    """Linear Rec.709 of an .exr, Radiance (.hdr, .pic) or float .tif file; values are not checked.

    What was done to them that other readers leave out, or that loses something, is logged: colours
    converted, values divided by EXPOSURE, pixels that are transparent.

    Parameters
    ----------
    layer
        Of an .exr with several: its name, with or without the view layer ("Combined").

    Raises
    ------
    InputError
        A file that is missing, damaged, too large, or of a kind or in colours that are not known.
    """
    suffix = path.suffix.lower()
    if path.is_dir():
        raise InputError(f"{path}: is a folder, not a file; give the path of an .exr or .hdr file")
    if not path.exists():
        raise InputError(f"{path}: there is no such file; give the path of an .exr or .hdr file")
    if layer is not None and suffix != ".exr":
        raise InputError(f"{path}: only .exr files have layers; leave the layer out")
    try:
        if suffix == ".exr":
            pixels, notes = read_exr(path, layer)
        elif suffix in RADIANCE_SUFFIXES:
            pixels, notes = read_radiance(path)
        elif suffix in _TIFF_SUFFIXES:
            pixels, notes = read_tiff(path)
        else:
            raise InputError(
                f"{path}: '{path.suffix}' is no HDR format known here: use .exr or .hdr "
                "(Radiance), or a float .tif"
            )
    # the attributes of an OpenEXR header may be of any type
    except (OSError, ValueError, TypeError, KeyError, MemoryError) as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise InputError(f"{path}: cannot be read: {reason}") from error
    for note in notes:
        say(path, note)
    return np.ascontiguousarray(pixels, dtype=np.float32)


def say(path: Path, note: str) -> None:
    """Log what a reader should know of a file; without a handler it goes to standard error."""
    line = f"skylight: {path}: {note}"
    # it may quote a file, and goes to a terminal
    shown = "".join(each if each.isprintable() else " " for each in line)
    logging.getLogger(__name__).warning("%s", shown)


def read_radiances(
    path: Path, *, layer: str | None = None, repair: bool = False
) -> Float[np.ndarray, "h w 3"]:
    """:func:`read_linear`, with values that are radiances: finite and >= 0.

    ``repair`` replaces up to a twentieth of the pixels: infinite values by the largest of half
    precision, 65504, beyond which they became infinite, or the largest of the map if that is more;
    NaN by the mean of the values near; negative ones that are small by 0. It is logged.

    Raises
    ------
    InputError
        As :func:`read_linear`; values that are none, or too many or too negative to repair.
    """
    pixels = read_linear(path, layer=layer)
    told = fault(pixels)
    if told is None:
        return pixels
    if not repair:
        raise InputError(
            f"{path}: {told}; replace these pixels, or write a repaired map: skylight convert IN "
            "OUT --repair"
        )
    bad = ~np.isfinite(pixels) | (pixels < 0)
    if bad.any(-1).mean() > _REPAIRED_MOST:
        raise InputError(f"{path}: {told}, which are too many to repair; export it again")
    mended = _repaired(pixels)
    if mended is None:
        raise InputError(f"{path}: {told}, which is too negative to be rounding; export it again")
    say(path, f"repaired ({told})")
    return mended


def read_latlong(
    path: Path, *, layer: str | None = None, repair: bool = False
) -> Float[np.ndarray, "h w 3"]:
    """:func:`read_radiances` of a lat-long map: of the sphere (w = 2 h) or the sky (w = 4 h)."""
    pixels = read_radiances(path, layer=layer, repair=repair)
    height, width = pixels.shape[:2]
    if width in (2 * height, 4 * height):
        return pixels
    mend = "crop or resize it"
    if width == height:
        mend = "a square is read by skylight convert --from angular (mirrorball, octahedral)"
    elif 3 * width == 4 * height or 4 * width == 3 * height:
        mend = "a cross of a cube's faces is read by skylight convert --from cube"
    raise InputError(
        f"{path}: {width}x{height} (width x height) is no lat-long map: expected a width of "
        f"2 heights (whole sphere) or 4 heights (upper half); {mend}"
    )


def fault(pixels: Float[np.ndarray, "h w 3"]) -> str | None:
    """What is wrong with these as radiances, in words: counts of pixels and the first place."""
    kinds = {"NaN": np.isnan(pixels), "infinite": np.isinf(pixels), "negative": pixels < 0}
    counts = {name: int(bad.any(-1).sum()) for name, bad in kinds.items()}
    if not any(counts.values()):
        return None
    row, column = np.argwhere(np.any(list(kinds.values()), axis=(0, 3)))[0]
    listed = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    where = f"the first at row {row}, column {column}"
    return f"radiance must be finite and >= 0, got {listed} pixel(s), {where}"


def _repaired(pixels: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"] | None:
    """The pixels mended; None where a negative one is too large for that."""
    good = np.isfinite(pixels) & (pixels >= 0)
    known = np.where(good, pixels, 0)
    level = np.maximum(known.max(-1, keepdims=True), known.mean())
    below = pixels < 0
    if (below & (-pixels > _SMALL * level)).any():
        return None
    mended = np.where(below, np.float32(0), pixels)
    mended[np.isposinf(pixels)] = max(HALF_MAX, float(known.max()))
    return _filled(mended, np.isnan(pixels))


def _filled(
    pixels: Float[np.ndarray, "h w 3"], holes: Bool[np.ndarray, "h w 3"]
) -> Float[np.ndarray, "h w 3"]:
    """Holes as the mean of what is known in the smallest square about them that holds any.

    Columns go round, as those of a lat-long map.
    """
    size, longest = 3, 2 * max(pixels.shape[:2])
    values = np.where(holes, 0, pixels)
    while holes.any() and size < longest:
        total, share = (_means(each.astype(np.float64), size) for each in (values, ~holes))
        found = holes & (share > 0.5 / size**2)
        values[found] = (total[found] / share[found]).astype(np.float32)
        holes = holes & ~found
        size = 2 * size + 1
    return values


def _means(values: Float[np.ndarray, "h w 3"], size: int) -> Float[np.ndarray, "h w 3"]:
    """Means over squares of ``size`` pixels, of values of 0 or more."""
    side = size // 2
    around = np.pad(values, ((0, 0), (side, side), (0, 0)), mode="wrap")
    around = np.pad(around, ((side, side), (0, 0), (0, 0)), mode="edge")
    means = cv2.boxFilter(around, -1, (size, size))[side:-side, side:-side]
    # its running sums lose 1e-16 of the largest value that they have passed
    return np.maximum(means, 0)
