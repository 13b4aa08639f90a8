"""OpenEXR and Radiance RGBE files as linear Rec.709 float32 pixels, and RGBD codes of such pixels.

What the pixels mean, and whether they make sense, is for :mod:`skylight.io._files` (light)
and :mod:`skylight.imaging._photo` (photographs).

RGBD is high dynamic range in 8-bit RGBA: colours times D, with D as alpha, as Babylon.js reads it
(helperFunctions, fromRGBD): ``rgb = (code / 255)^2.2 / D``, ``D = alpha``. EXT_lights_image_based
calls it RGBD and leaves the curve open.
"""

import math
import os
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
from jaxtyping import Float, UInt8

from skylight.errors import InputError
from skylight.io._bounded import PICTURE_BYTES_MAX, file_bytes, require_bytes, require_pixels

# CIE xy of red, green, blue and white: ITU-R BT.709-6, table 1.3 and 1.4 (white is D65).
REC709_CHROMATICITIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
HALF_MAX = 65504.0  # the largest finite IEEE 754 binary16
RGBE_MAX = 2.0**127 * (255 / 256)  # the largest mantissa at the largest exponent byte

SUFFIXES = (".exr", ".hdr")
_FLAT_PARTS = (OpenEXR.scanlineimage, OpenEXR.tiledimage)  # not deep: as many samples as they like
_RESOLUTION = re.compile(rb"-Y\s*([+-]?\d{1,12})\s*\+X\s*([+-]?\d{1,12})")

_native_output = threading.Lock()


def read_linear(path: Path) -> Float[np.ndarray, "h w 3"]:
    """Linear RGB of an .exr or .hdr file; values are not checked.

    Raises :class:`InputError` for a file that is missing, damaged, too large, not in Rec.709, or
    whose channels are neither R, G, B nor Y.
    """
    if not path.is_file():
        kind = "is a folder, not a file" if path.is_dir() else "there is no such file"
        raise InputError(f"{path}: {kind}; give the path of an .exr or .hdr file")
    check_suffix(path)
    try:
        pixels = _read_exr(path) if path.suffix.lower() == ".exr" else _read_radiance(path)
    # the attributes of an OpenEXR header may be of any type
    except (OSError, ValueError, TypeError, KeyError, MemoryError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give another file") from error
    return np.ascontiguousarray(pixels, dtype=np.float32)


def check_suffix(path: Path) -> None:
    """Raise :class:`InputError` unless the name ends in .exr or .hdr."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"{path}: '{path.suffix}' is no HDR format known here: use .exr or .hdr (Radiance)"
        )


def write_exr(
    path: Path, rgb: Float[np.ndarray, "h w 3"], *, half: bool, header: dict[str, object]
) -> None:
    """Write a scan-line, ZIP-compressed EXR in Rec.709; an :class:`OSError` where that fails.

    With ``half``, values above :data:`HALF_MAX` would become infinite: check first.
    """
    # the writer stores the memory as it lies: a strided view would come out scrambled
    pixels = np.ascontiguousarray(rgb, dtype=np.float16 if half else np.float32)
    complete = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "chromaticities": REC709_CHROMATICITIES,
        **header,
    }
    try:
        with muted():
            OpenEXR.File(complete, {"RGB": pixels}).write(str(path))
    except RuntimeError as error:  # its message names the file first, then the reason
        raise OSError(str(error).rpartition('". ')[2].rstrip(".")) from error


def write_radiance(path: Path, rgb: Float[np.ndarray, "h w 3"]) -> None:
    """Write a flat (uncompressed) Radiance RGBE file of :func:`rgbe_codes`."""
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {rgb.shape[0]} +X {rgb.shape[1]}\n"
    path.write_bytes(head.encode("ascii") + rgbe_codes(rgb).tobytes())


def rgbe_codes(rgb: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 4"]:
    """Radiance's codes (m_R, m_G, m_B, e), which stand for ``m 2^(e - 136)``.

    Own code, because OpenCV truncates the 8-bit mantissas, which darkens a map by 0.3 % on
    average; these are rounded: channel error <= max(R, G, B) / 256, unbiased. Values above
    :data:`RGBE_MAX` do not fit: check first. Format: Ward, "Real Pixels", Graphics Gems II, 1991.
    """
    peak = rgb.max(-1)
    _, exponent = np.frexp(peak)
    # a mantissa that would round up to 256 belongs to the next exponent
    exponent += np.rint(np.ldexp(peak, 8 - exponent)) == 256
    visible = exponent > -128
    mantissa = np.rint(np.ldexp(rgb.astype(np.float64), 8 - exponent[..., None]))
    rgbe = np.concatenate([mantissa, exponent[..., None] + 128], -1) * visible[..., None]
    return rgbe.astype(np.uint8)


def _read_exr(path: Path) -> Float[np.ndarray, "h w 3"]:
    require_bytes(path)
    try:
        with muted():
            _require_flat(OpenEXR.File(str(path), header_only=True))
            file = OpenEXR.File(str(path), separate_channels=True)
    except RuntimeError:
        file = None
    # a part whose pixels are damaged is left out without an exception
    if file is None or not file.parts:
        raise InputError(f"{path}: damaged, cut short or no OpenEXR file: fetch or export it again")
    header, channels = file.header(), file.channels()
    if not np.array_equal(header["dataWindow"], header["displayWindow"]):
        raise InputError(f"{path}: only a part of the picture is stored: export it uncropped")
    chromaticities = header.get("chromaticities", REC709_CHROMATICITIES)
    if not np.allclose(chromaticities, REC709_CHROMATICITIES, atol=2e-3):
        raise InputError(
            f"{path}: its chromaticities are not Rec.709 with a D65 white: convert it to linear "
            "Rec.709 (linear sRGB)"
        )
    names = ("Y", "Y", "Y") if set(channels) in ({"Y"}, {"Y", "A"}) else ("R", "G", "B")
    if not set(names) <= set(channels):
        raise InputError(
            f"{path}: expected the channels R, G, B or Y, got {', '.join(sorted(channels))}: "
            "export a plain RGB file"
        )
    pixels = [channels[name].pixels for name in names]
    if any(p.dtype not in (np.float16, np.float32) for p in pixels):
        raise InputError(f"{path}: expected half or float pixels, got {pixels[0].dtype}")
    return np.stack(pixels, axis=-1)


def _require_flat(file: OpenEXR.File) -> None:
    """ValueError for more pixels than are read; the library takes their memory first."""
    together = 0
    for part in file.parts:
        if part.header.get("type", OpenEXR.scanlineimage) not in _FLAT_PARTS:
            raise ValueError("deep pixels are not read, flatten them")
        low, high = (np.array(corner, dtype=np.int64) for corner in part.header["dataWindow"])
        width, height = (high - low + 1).tolist()
        require_pixels(width, height)
        together += 4 * width * height * len(part.header["channels"])
    if together > PICTURE_BYTES_MAX:
        raise ValueError(f"its channels of {together} bytes exceed the {PICTURE_BYTES_MAX} read")


def radiance_sizes(data: bytes) -> list[tuple[int, int]]:
    """(height, width) wherever a Radiance file tells one; OpenCV takes one of them."""
    return [(int(height), int(width)) for height, width in _RESOLUTION.findall(data)]


def _read_radiance(path: Path) -> Float[np.ndarray, "h w 3"]:
    data = file_bytes(path)
    sizes = radiance_sizes(data)
    for height, width in sizes:
        require_pixels(width, height)
    # a row takes 4 bytes a pixel, or a mark of 4 bytes and 2 for each run of 127 in each channel
    least = min((h * min(4 * w, 4 + 8 * math.ceil(w / 127)) for h, w in sizes), default=0)
    bgr = None
    if data.startswith(b"#?") and sizes and len(data) >= least:
        # OpenCV raises for more than 2^20 pixels a side
        with muted(), suppress(cv2.error):
            bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if bgr is None or bgr.dtype != np.float32 or bgr.ndim != 3:
        raise InputError(f"{path}: damaged, cut short or no Radiance RGBE file: export it again")
    return bgr[..., ::-1]


@contextmanager
def muted() -> Iterator[None]:
    """Drop what the libraries print: the exception says it in one line.

    OpenEXR reports a damaged file through Python's ``print``, where it would spoil a command's
    result, and on the process's standard error; OpenCV on the latter. Both belong to the whole
    process, hence the lock.
    """
    with _native_output, open(os.devnull, "w") as nowhere, redirect_stdout(nowhere):
        kept = os.dup(2)
        try:
            os.dup2(nowhere.fileno(), 2)
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)


LARGEST = 255.0  # what the smallest D, 1 / 255, can stand for
_GAMMA = 2.2


def encode_rgbd(rgb: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 4"]:
    """D = floor(255 / max(R, G, B)) / 255, at most 1: the largest that keeps the colour below 1.

    The relative error of the largest channel is below 1 % where it exceeds 0.5 (a code in 255 of
    the 2.2th root), growing to 5 % at 0.02. Values above 255 must be scaled down before.
    """
    if rgb.size and rgb.max() > LARGEST:
        raise ValueError(f"RGBD holds values up to {LARGEST:g}, got {rgb.max():.6g}: scale it down")
    peak = np.maximum(rgb.max(-1, keepdims=True), 1.0)
    alpha = np.floor(255.0 / peak)
    held = np.clip(rgb * (alpha / 255.0), 0.0, 1.0) ** (1 / _GAMMA)
    return np.concatenate([np.rint(255.0 * held), alpha], -1).astype(np.uint8)
