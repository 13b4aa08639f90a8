"""Radiance pictures (.hdr, .pic): header, orientation, pixels and declared colours.

Format: Ward, "Real Pixels", Graphics Gems II, 1991, and Radiance's "File formats". New run lengths
are decoded by OpenCV under a plain header; old ones, and rows that lie across, no library reads.
"""

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from skylight.io._bounded import file_bytes, require_pixels
from skylight.io._colour_spaces import TOLERANCE, ColourSpace, converted
from skylight.io._muted import muted

_AXES = re.compile(rb"([+-])([XY])\s*\+?(\d{1,12})\s*([+-])([XY])\s*\+?(\d{1,12})\s*")
_FORMATS = {"32-bit_rle_rgbe": "rec709", "32-bit_rle_xyze": "xyz-d65"}
# Radiance's STDPRIMS, which no reader converts where the line is left out
_DEFAULT = (0.640, 0.330, 0.290, 0.600, 0.150, 0.060, 1 / 3, 1 / 3)
_ROW_MAX = 0x7FFF  # pixels of a row with new run lengths
_HEADER_MOST = 2**20  # bytes


@dataclass(frozen=True, kw_only=True)
class _Header:
    """``lines`` scan lines of ``length`` pixels from byte ``start`` on, and what is declared.

    Scan lines are rows from the top, pixels in them from the left, unless the flags say otherwise.
    """

    lines: int
    length: int
    across: bool
    upwards: bool
    leftwards: bool
    start: int
    declared: tuple[tuple[str, str], ...]

    @property
    def size(self) -> tuple[int, int]:
        """(height, width)."""
        return (self.length, self.lines) if self.across else (self.lines, self.length)


def radiance_size(data: bytes) -> tuple[int, int]:
    """(height, width) that a Radiance file tells; ValueError where it tells none."""
    return _header(data).size


def read_radiance(path: Path) -> tuple[Float[np.ndarray, "h w 3"], list[str]]:
    """(linear Rec.709, what was done otherwise than other readers do).

    Radiance is what is stored over the products of all EXPOSURE and all COLORCORR lines.

    Raises
    ------
    OSError, ValueError
        A file that cannot be opened; that is no Radiance picture, cut short or too large; whose
        pixels or declared colours are of a kind that is not known.
    """
    data = file_bytes(path)
    header = _header(data)
    require_pixels(*header.size)
    pixels = _pixels(data[header.start :], header.lines, header.length)
    if header.across:
        pixels = pixels.transpose(1, 0, 2)
    if header.upwards:
        pixels = pixels[::-1]
    if header.leftwards:
        pixels = pixels[:, ::-1]
    return _as_declared(pixels, header.declared)


def _header(data: bytes) -> _Header:
    if not data.startswith(b"#?"):
        reason = "no Radiance file, which begins with #?" if data else "damaged: it is empty"
        raise ValueError(f"{reason}; fetch or export it again")
    declared: list[tuple[str, str]] = []
    start = 0
    while (end := data.find(b"\n", start, _HEADER_MOST)) >= 0:
        line, start = data[start:end], end + 1
        if axes := _AXES.fullmatch(line.rstrip()):
            (first, axis, lines, second, other, length) = axes.groups()
            if axis == other:
                break
            signs = {axis: first, other: second}
            return _Header(
                lines=int(lines),
                length=int(length),
                across=axis == b"X",
                upwards=signs[b"Y"] == b"+",
                leftwards=signs[b"X"] == b"-",
                start=start,
                declared=tuple(declared),
            )
        if not line[:1].isspace():  # indented are headers of pictures that it was made of
            name, equals, value = line.decode("latin-1").partition("=")
            if equals:
                declared.append((name.strip(), value.strip()))
    raise ValueError("damaged or cut short: no line of its header tells the resolution")


def _pixels(body: bytes, lines: int, length: int) -> Float[np.ndarray, "h w 3"]:
    is_new = body[:2] == b"\2\2" and length == int.from_bytes(body[2:4], "big")
    if is_new and 8 <= length <= _ROW_MAX:
        # a row takes a mark of 4 bytes and 2 for each run of 127 in each channel
        bgr = None
        if len(body) >= lines * (4 + 8 * math.ceil(length / 127)):
            plain = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (lines, length)
            with muted(), suppress(cv2.error):
                bgr = cv2.imdecode(np.frombuffer(plain + body, np.uint8), cv2.IMREAD_UNCHANGED)
        if bgr is None or bgr.dtype != np.float32 or bgr.shape != (lines, length, 3):
            raise ValueError("damaged or cut short: its run lengths do not fill the picture")
        return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB, dst=bgr)
    codes = np.frombuffer(body[: len(body) // 4 * 4], np.uint8).reshape(-1, 4)
    codes = _old_runs(codes, lines * length)
    return rgbe_values(codes.reshape(lines, length, 4))


def _old_runs(codes: UInt8[np.ndarray, "n 4"], count: int) -> UInt8[np.ndarray, "m 4"]:
    """The pixels of old run lengths, or of none: (1, 1, 1, n) repeats the pixel before it n times.

    Of several such marks in a row the second counts 256 n, the third 65536 n.
    """
    short = ValueError(f"damaged or cut short: it holds fewer than its {count} pixels")
    is_run = (codes[:, :3] == 1).all(1)
    if len(codes) == count or not is_run.any():  # of that length it was not packed
        if len(codes) < count:
            raise short
        return codes[:count]
    index = np.arange(len(codes))
    before = np.maximum.accumulate(np.where(is_run, -1, index))  # the pixel that is repeated
    place = np.minimum(index - before - 1, 4)  # of a mark in its row of marks
    if before[0] < 0 or place.max() > 3:
        raise ValueError("damaged: its old run lengths repeat nothing")
    counts = np.where(is_run, codes[:, 3].astype(np.int64) << 8 * np.maximum(place, 0), 1)
    filled = np.cumsum(counts)
    last = int(np.searchsorted(filled, count))
    if last == len(codes) or filled[last] != count:
        raise short
    return np.repeat(codes[before[: last + 1]], counts[: last + 1], axis=0)


def rgbe_values(codes: UInt8[np.ndarray, "h w 4"]) -> Float[np.ndarray, "h w 3"]:
    """The values ``m 2^(e - 136)`` of codes (m_R, m_G, m_B, e), 0 where e is 0; float32, exact."""
    exponent = codes[..., 3:].astype(np.int32)
    scale = np.ldexp(np.float32(1), exponent - 136) * (exponent > 0)
    return codes[..., :3] * scale.astype(np.float32)


def _as_declared(
    pixels: Float[np.ndarray, "h w 3"], declared: Sequence[tuple[str, str]]
) -> tuple[Float[np.ndarray, "h w 3"], list[str]]:
    """(linear Rec.709, what was done) of stored values under a header's variables."""
    notes: list[str] = []
    kind = next((value for name, value in reversed(declared) if name == "FORMAT"), None)
    if kind is not None and kind not in _FORMATS:
        raise ValueError(f"its pixels are {kind!r}, expected {' or '.join(_FORMATS)}; convert it")
    for gamma in _numbers(declared, "GAMMA", 1):
        if gamma[0] != 1:
            # some writers tell the exponent that encoded, others its inverse; light is encoded
            # by one below 1
            exponent = float(max(gamma[0], 1 / gamma[0]))
            pixels, said = converted(pixels, ColourSpace(transfer=exponent))
            notes += [f"{line} (GAMMA)" for line in said]
    for name, count in (("EXPOSURE", 1), ("COLORCORR", 3)):
        factor = np.prod([np.ones(count), *_numbers(declared, name, count)], axis=0)
        if (factor != 1).any():
            with np.errstate(over="ignore"):
                pixels = (pixels / factor).astype(np.float32)
            told = " ".join(f"{each:g}" for each in factor)
            notes.append(f"its values are divided by {name} {told}, which other readers ignore")
    space = None
    if kind is not None and _FORMATS[kind] == "xyz-d65":
        space = ColourSpace(primaries="xyz-d65")
    else:
        for primaries in _numbers(declared, "PRIMARIES", 8, positive=False):
            # some writers put zeros for what they do not know, others what a file without has too
            if primaries.any() and not np.allclose(primaries, _DEFAULT, rtol=0, atol=TOLERANCE):
                x = [float(each) for each in primaries]
                space = ColourSpace(primaries=(x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7]))
    pixels, said = converted(pixels, space)
    aspects = [float(each[0]) for each in _numbers(declared, "PIXASPECT", 1)]
    if abs(math.prod(aspects) - 1) > 1e-3:
        notes.append(
            f"its pixels are {math.prod(aspects):g} times as high as wide (PIXASPECT); they are "
            "taken as they are stored, not resampled"
        )
    return pixels, [*notes, *said]


def _numbers(
    declared: Sequence[tuple[str, str]], wanted: str, count: int, *, positive: bool = True
) -> list[Float[np.ndarray, " n"]]:
    """The numbers of each line of a name, as float64."""
    found = []
    for name, value in declared:
        if name != wanted:
            continue
        try:
            numbers = np.array([float(each) for each in value.replace(",", " ").split()])
        except ValueError:
            numbers = np.empty(0)
        usable = len(numbers) == count and np.isfinite(numbers).all()
        if not usable or (positive and numbers.min() <= 0):
            raise ValueError(f"its header says {wanted}={value[:80]}, expected {count} number(s)")
        found.append(numbers)
    return found
