"""Linear Rec.709 pixels written as OpenEXR and Radiance RGBE files, and as RGBD codes.

They are read by :mod:`skylight.io._light`.

RGBD is high dynamic range in 8-bit RGBA: colours times D, with D as alpha, as Babylon.js reads it
(helperFunctions, fromRGBD): ``rgb = (code / 255)^2.2 / D``, ``D = alpha``. EXT_lights_image_based
calls it RGBD and leaves the curve open.
"""

from pathlib import Path

import numpy as np
import OpenEXR
from jaxtyping import Float, UInt8

from skylight.errors import InputError
from skylight.io._colour_spaces import CHROMATICITIES
from skylight.io._muted import muted

HALF_MAX = 65504.0  # the largest finite IEEE 754 binary16
RGBE_MAX = 2.0**127 * (255 / 256)  # the largest mantissa at the largest exponent byte

RADIANCE_SUFFIXES = (".hdr", ".pic")
SUFFIXES = (".exr", *RADIANCE_SUFFIXES)


def check_suffix(path: Path) -> None:
    """Raise :class:`InputError` unless a map can be written under that name."""
    if path.suffix.lower() not in (".exr", ".hdr"):
        raise InputError(
            f"{path}: '{path.suffix}' is no HDR format that is written: use .exr or .hdr (Radiance)"
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
        "chromaticities": CHROMATICITIES["rec709"],
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
