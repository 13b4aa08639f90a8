"""OpenEXR files: which layer is light, where it lies, and in which colours it is stored."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR
from jaxtyping import Float

from skylight.errors import InputError
from skylight.io._bounded import PICTURE_BYTES_MAX, require_bytes, require_pixels
from skylight.io._colour_spaces import (
    CHROMATICITIES,
    TOLERANCE,
    Chromaticities,
    ColourSpace,
    colour_space_named,
    converted,
    to_xyz,
)
from skylight.io._muted import muted

_MAGIC = b"\x76\x2f\x31\x01"
_FLAT_PARTS = (OpenEXR.scanlineimage, OpenEXR.tiledimage)  # not deep: as many samples as they like
_TRIPLES = (("r", "g", "b"), ("red", "green", "blue"))
_MAIN = ("combined", "beauty", "rgba", "rgb")  # what programs call the picture among its layers
_LISTED = 12


@dataclass(frozen=True, kw_only=True)
class _Layer:
    """The channels of R, G, B, of Y, RY, BY or of Y alone in one part, and of A where it has it."""

    name: str
    part: int
    is_plain: bool
    colours: tuple[str, ...]
    alpha: str | None


def read_exr(path: Path, layer: str | None) -> tuple[Float[np.ndarray, "h w 3"], list[str]]:
    """(linear Rec.709 of a layer, what was done in words).

    By default the layer is the one without a name of the first part with colours, else the only
    one, else the one that programs call the picture ("ViewLayer.Combined").

    Raises
    ------
    InputError
        No layer of that name, or several without one.
    OSError, ValueError, TypeError, KeyError
        A file that cannot be opened, is no OpenEXR file, damaged, deep or too large; whose colours
        are not known; of which only a part is stored.
    """
    require_bytes(path)
    parts = _parts(path)
    layers = _layers(parts)
    chosen = _chosen(path, parts, layers, layer)
    part = parts[chosen.part]
    header = part.header
    names = [*chosen.colours, *([chosen.alpha] if chosen.alpha else [])]
    stored = {name: part.channels[name] for name in names}
    kinds = {str(stored[name].pixels.dtype) for name in chosen.colours}
    if not kinds <= {"float16", "float32"}:
        raise ValueError(
            f"expected half or float pixels, got {', '.join(sorted(kinds))}: whole numbers are "
            "masks or IDs, not light; export half or float"
        )
    space = _colour_space(header)
    if len(chosen.colours) == 3 and chosen.colours[1].endswith("RY"):
        pixels = _of_luminance_chroma([stored[name] for name in chosen.colours], header, space)
    else:
        if any((channel.xSampling, channel.ySampling) != (1, 1) for channel in stored.values()):
            raise ValueError(
                f"{', '.join(chosen.colours)} are subsampled, stored at some of the pixels only: "
                "export them at full resolution"
            )
        pixels = np.empty((*stored[names[0]].pixels.shape, 3), np.float32)
        for index in range(3):
            pixels[..., index] = stored[chosen.colours[index % len(chosen.colours)]].pixels
    window = _shown(header)
    pixels, said = converted(pixels[window], space)
    several = f"its layer {chosen.name} is read, of {_listed(layers)}"
    notes = [several, *said] if _is_one_of(chosen, layers) else said
    if chosen.alpha:
        notes += transparency(stored[chosen.alpha].pixels[window], pixels)
    aspect = float(header.get("pixelAspectRatio", 1.0))
    if abs(aspect - 1) > 1e-3:
        notes.append(
            f"its pixels are {aspect:g} times as wide as high (pixelAspectRatio); they are taken "
            "as they are stored, not resampled"
        )
    return pixels, notes


def white_luminance(path: Path) -> float | None:
    """The standard attribute: cd/m^2 of the value (1, 1, 1); None of files that lack it.

    0 stands for unknown too; so does what is no .exr that can be read.
    """
    if path.suffix.lower() != ".exr" or not path.is_file():
        return None
    try:
        with muted():
            header = OpenEXR.File(str(path), header_only=True).header()
        told = float(header.get("whiteLuminance", 0))
    except (RuntimeError, TypeError, ValueError):
        return None
    return told if 0 < told < math.inf else None


def transparency(alpha: Float[np.ndarray, "h w"], pixels: Float[np.ndarray, "h w 3"]) -> list[str]:
    """What alpha says of light that is missing, in words; none where it says nothing.

    Colours are stored premultiplied, so light is what they say; alpha tells where behind them
    nothing was. Alpha 0 with colours is no hole: some programs leave alpha empty.
    """
    if alpha.min() >= 0.999:
        return []
    holes = int((pixels[alpha <= 0] <= 0).all(-1).sum())
    half = int(((alpha > 0) & (alpha < 0.999)).sum())
    counts = [f"{holes} pixel(s) are transparent and black"] if holes else []
    counts += [f"{half} pixel(s) are half transparent"] if half else []
    return [f"{' and '.join(counts)} (alpha): light is missing there"] if counts else []


def _parts(path: Path) -> list[OpenEXR.Part]:
    """All parts with their pixels."""
    with path.open("rb") as stream:
        begin = stream.read(len(_MAGIC))
    if begin != _MAGIC:
        reason = "no OpenEXR file, whatever its name says" if begin else "damaged: it is empty"
        raise ValueError(f"{reason}; fetch or export it again")
    try:
        with muted():
            header = OpenEXR.File(str(path), header_only=True)
            _require_flat(header)
    except RuntimeError as error:
        raise ValueError(
            "its header is damaged or cut short, or newer than this version of OpenEXR: fetch or "
            "export it again"
        ) from error
    try:
        with muted():
            parts = OpenEXR.File(str(path), separate_channels=True).parts
    except RuntimeError:
        parts = []
    # a part whose pixels are damaged is left out without an exception
    if len(parts) != len(header.parts) or not parts:
        raise ValueError("damaged or cut short: fetch or export it again")
    return parts


def _require_flat(file: OpenEXR.File) -> None:
    """ValueError for more pixels than are read; the library takes their memory first."""
    together = 0
    for part in file.parts:
        if part.header.get("type", OpenEXR.scanlineimage) not in _FLAT_PARTS:
            raise ValueError("deep pixels are not read: flatten them (oiiotool --flatten)")
        low, high = _window(part.header, "dataWindow")
        width, height = (high - low).tolist()
        require_pixels(width, height)
        together += 4 * width * height * len(part.header["channels"])
    if together > PICTURE_BYTES_MAX:
        raise ValueError(f"its channels of {together} bytes exceed the {PICTURE_BYTES_MAX} read")


def _window(header: dict, name: str) -> tuple[np.ndarray, np.ndarray]:
    """(first, one past the last) pixel (x, y) of a window."""
    low, high = (np.array(corner, dtype=np.int64) for corner in header[name])
    return low, high + 1


def _shown(header: dict) -> tuple[slice, slice]:
    """Rows and columns of the stored pixels that the display window shows."""
    (low, high), (first, last) = _window(header, "dataWindow"), _window(header, "displayWindow")
    if (low > first).any() or (high < last).any():
        (stored, shown) = ("x".join(map(str, size)) for size in (high - low, last - first))
        raise ValueError(
            f"only a part of the picture is stored, {stored} pixels from {low.tolist()} of {shown} "
            "from " + f"{first.tolist()}: export it uncropped"
        )
    (x, y), (x_end, y_end) = first - low, last - low
    return slice(y, y_end), slice(x, x_end)


def _layers(parts: Sequence[OpenEXR.Part]) -> list[_Layer]:
    """All layers with colours, those of one luminance only where there are no others."""
    found: list[_Layer] = []
    is_data = [str(part.header.get("colorInteropID", "")).lower() == "data" for part in parts]
    for number, part in enumerate(parts):
        if is_data[number] and not all(is_data):
            continue  # normals and the like
        groups: dict[str, dict[str, str]] = {}
        for full in part.channels:
            prefix, _, base = full.rpartition(".")
            groups.setdefault(prefix, {})[base] = full
        own = str(part.header.get("name", number)) if len(parts) > 1 else ""
        for prefix, names in groups.items():
            colours = _colours(names)
            if colours:
                layer = _Layer(
                    name=".".join(filter(None, (own, prefix))),
                    part=number,
                    is_plain=not prefix,
                    colours=colours,
                    alpha=names.get("A", names.get("a")),
                )
                found.append(layer)
    return [each for each in found if len(each.colours) == 3] or found


def _colours(names: dict[str, str]) -> tuple[str, ...]:
    """The channels of colour among those of a layer, by their names within it; none if none."""
    if {"R", "G", "B"} <= names.keys():
        return names["R"], names["G"], names["B"]
    lower = {base.lower(): full for base, full in names.items()}
    for triple in _TRIPLES:
        if set(triple) <= lower.keys():
            return tuple(lower[base] for base in triple)
    if {"Y", "RY", "BY"} <= names.keys():
        return names["Y"], names["RY"], names["BY"]
    if "y" in lower and "x" not in lower:  # else they are coordinates
        return (lower["y"],)
    return ()


def _chosen(
    path: Path, parts: Sequence[OpenEXR.Part], layers: list[_Layer], wanted: str | None
) -> _Layer:
    if not layers:
        told = sorted({name for part in parts for name in part.channels})
        raise InputError(
            f"{path}: expected the channels R, G, B or Y, got {', '.join(told[:_LISTED])}: export "
            "a plain RGB file"
        )
    if wanted is not None:
        key = wanted.strip().strip(".").lower()
        fits = [each for each in layers if each.name.lower() == key]
        fits = fits or [each for each in layers if f".{each.name.lower()}".endswith(f".{key}")]
        fits = fits or [each for each in layers if each.name.lower().startswith(f"{key}.")]
        if len(fits) == 1 or (fits and fits[0].name.lower() == key):
            return fits[0]
        raise InputError(
            f"{path}: {wanted!r} is not one of its layers with colours, {_listed(layers)}: name one"
        )
    inside = [each for each in layers if each.part == layers[0].part]
    plain = [each for each in inside if each.is_plain]
    main = [each for each in inside if each.name.lower().rpartition(".")[2] in _MAIN]
    for choice in (plain, main, inside):
        if len(choice) == 1:
            return choice[0]
    raise InputError(
        f"{path}: it has several layers, {_listed(layers)}: export one of them alone, or name it "
        "where a command has --layer, as skylight convert"
    )


def _is_one_of(chosen: _Layer, layers: list[_Layer]) -> bool:
    """Whether others could have been meant: not where a file has one plain picture."""
    others = [each for each in layers if each is not chosen]
    return any(each.is_plain for each in others) if chosen.is_plain else bool(others)


def _listed(layers: Sequence[_Layer]) -> str:
    names = [each.name or "one without a name" for each in layers]
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return ", ".join(names[:_LISTED]) + more


def _colour_space(header: dict) -> ColourSpace | None:
    """What a part declares, by colorInteropID, chromaticities or OpenImageIO's attribute."""
    xy = _chromaticities(header)
    named = colour_space_named(str(header.get("colorInteropID", "")))
    if named is None:
        other = colour_space_named(str(header.get("oiio:ColorSpace", "")))
        if xy is None:
            return other
        return ColourSpace(primaries=xy, transfer=other.transfer if other else "linear")
    told = CHROMATICITIES.get(named.primaries) if isinstance(named.primaries, str) else None
    if xy is not None and told is not None and not np.allclose(xy, told, atol=TOLERANCE):
        raise ValueError(
            f"its colorInteropID says {named} and its chromaticities say others: export it with "
            "one of them"
        )
    return named


def _chromaticities(header: dict) -> Chromaticities | None:
    if "chromaticities" in header:
        x = [float(each) for each in header["chromaticities"]]
        return x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7]
    # SMPTE ST 2065-4 asks for the chromaticities too
    return CHROMATICITIES["ap0"] if header.get("acesImageContainerFlag") == 1 else None


# Of OpenEXR's ImfRgbaYca.cpp: the weights of samples 1, 3, ... 13 pixels to either side
_BETWEEN = (0.627123, -0.186077, 0.087929, -0.043159, 0.019597, -0.007540, 0.002128)


def _of_luminance_chroma(
    channels: Sequence[OpenEXR.Channel], header: dict, space: ColourSpace | None
) -> Float[np.ndarray, "h w 3"]:
    """RGB of luminance and subsampled chroma, RY = (R - Y) / Y and BY = (B - Y) / Y.

    As RgbaInputFile makes it: chroma between samples is filtered, and colours that this made more
    saturated than their neighbours are desaturated, their luminance kept.
    """
    luminance, red, blue = channels
    samplings = {(channel.xSampling, channel.ySampling) for channel in (red, blue)}
    if (luminance.xSampling, luminance.ySampling) != (1, 1) or len(samplings) != 1:
        raise ValueError("its luminance is subsampled, which is not read: export RGB")
    ((across, down),) = samplings
    if (across, down) not in ((1, 1), (2, 2)):
        raise ValueError(f"its chroma is sampled {across} x {down}, expected 2 x 2: export RGB")
    y = luminance.pixels.astype(np.float32)
    chroma = np.stack([red.pixels, blue.pixels], -1).astype(np.float32)
    primaries = "rec709" if space is None else space.primaries
    weights = to_xyz(primaries)[1].astype(np.float32)  # OpenEXR's computeYw
    with np.errstate(all="ignore"):  # of NaN and infinity, which are refused where light is read
        if across == 2:
            chroma = _upsampled(_upsampled(chroma, y.shape[1], 1), y.shape[0], 0)
        r, b = (chroma[..., 0] + 1) * y, (chroma[..., 1] + 1) * y
        g = (y - weights[0] * r - weights[2] * b) / weights[1]
        pixels = np.stack([r, g, b], -1)
        pixels[(chroma == 0).all(-1)] = y[(chroma == 0).all(-1), None]  # greys are exact
        return _desaturated(pixels, weights)


def _upsampled(samples: np.ndarray, size: int, axis: int) -> np.ndarray:
    """Every second value given along an axis, those between them filtered."""
    samples = np.moveaxis(samples, axis, 0)
    whole = np.empty((size, *samples.shape[1:]), np.float32)
    whole[::2] = samples
    reach, count = len(_BETWEEN), len(whole[1::2])
    around = np.pad(samples, [(reach, reach), *[(0, 0)] * (samples.ndim - 1)], mode="edge")
    whole[1::2] = 0
    for step, weight in enumerate(_BETWEEN):
        before, after = reach - step, reach + 1 + step  # of the first pair of samples
        pair = around[before : before + count] + around[after : after + count]
        whole[1::2] += np.float32(weight) * pair
    return np.moveaxis(whole, 0, axis)


def _desaturated(
    pixels: Float[np.ndarray, "h w 3"], weights: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "h w 3"]:
    """OpenEXR's fixSaturation: by the saturations of the four diagonal neighbours."""
    peak, least = pixels.max(-1), pixels.min(-1)
    saturation = np.where(peak > 0, 1 - least / peak, 0)
    near = np.pad(saturation, 1, mode="edge")
    mean = (near[:-2, :-2] + near[:-2, 2:] + near[2:, :-2] + near[2:, 2:]) / 4
    most = np.minimum(1, 1 - (1 - np.minimum(mean, 1)) / 4)
    factor = np.where(saturation > most, most / saturation, 1)[..., None]
    less = np.maximum(peak[..., None] - (peak[..., None] - pixels) * factor, 0)
    before, after = pixels @ weights, less @ weights
    less *= np.where(after > 0, before / after, 1)[..., None]
    return np.where(factor < 1, less, pixels)
