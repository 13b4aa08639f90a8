"""Picture files of the layouts and declarations that libraries seldom write, byte by byte."""

import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import tifffile
from PIL import ExifTags, Image

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_KINDS = {1: 0, 2: 4, 3: 2, 4: 6}  # channels to PNG's colour types
_ADAM7 = (
    (0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2),
    (1, 0, 2, 1),
)  # fmt: skip


def scene(height: int = 48, width: int = 64) -> np.ndarray:
    """Codes of a smooth picture in which no corner, channel or direction is like another."""
    y, x = np.mgrid[:height, :width]
    channels = [30 + 200 * x / width, 40 + 180 * y / height, 128 + 60 * np.sin(x * y / 200)]
    return np.stack(channels, -1).astype(np.uint8)


def as_depth(codes: np.ndarray, depth: int) -> np.ndarray:
    """8-bit codes, or 16-bit ones of the same values."""
    return codes if depth == 8 else codes.astype(np.uint16) * 257


def write_png(
    path: Path,
    codes: np.ndarray,
    *,
    chunks: Mapping[bytes, bytes] | None = None,
    interlaced: bool = False,
) -> Path:
    """Codes (h,w) or (h,w,c) of 8 or 16 bits, with chunks before the pixels."""
    pixels = codes if codes.ndim == 3 else codes[..., None]
    height, width, channels = pixels.shape
    passes = _ADAM7 if interlaced else ((0, 0, 1, 1),)
    rows = b"".join(
        b"\0" + row.astype(pixels.dtype.newbyteorder(">")).tobytes()
        for top, left, down, right in passes
        for row in pixels[top::down, left::right]
    )
    header = struct.pack(
        ">IIBBBBB", width, height, 8 * codes.itemsize, _KINDS[channels], 0, 0, interlaced
    )
    parts = {b"IHDR": header, **(chunks or {}), b"IDAT": zlib.compress(rows), b"IEND": b""}
    path.write_bytes(_SIGNATURE + b"".join(_chunk(*part) for part in parts.items()))
    return path


def _chunk(name: bytes, content: bytes) -> bytes:
    crc = zlib.crc32(name + content)
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", crc)


def icc_profile(colorants: np.ndarray, gamma: float | tuple[float, ...]) -> bytes:
    """An RGB profile of XYZ under D50 (columns: red, green, blue) and one curve.

    The curve is a ``curv`` of a gamma, or a ``para`` of g, a, b, c, d (ICC.1:2022, 10.18).
    """
    if isinstance(gamma, tuple):
        curve = b"para" + bytes(4) + struct.pack(">HH", 3, 0) + _fixed(*gamma)
    else:
        curve = b"curv" + bytes(4) + struct.pack(">IHxx", 1, round(256 * gamma))
    corners = [b"XYZ " + bytes(4) + _fixed(*column) for column in colorants.T]
    named = [
        (b"rXYZ", corners[0]), (b"gXYZ", corners[1]), (b"bXYZ", corners[2]),
        (b"rTRC", curve), (b"gTRC", curve), (b"bTRC", curve),
    ]  # fmt: skip
    return profile_of(b"RGB ", dict(named))


def profile_of(colours: bytes, tags: Mapping[bytes, bytes]) -> bytes:
    """A display profile of such tags (ICC.1:2022, 7.2)."""
    at, table = 132 + 12 * len(tags), b""
    for name, content in tags.items():
        table += name + struct.pack(">II", at, len(content))
        at += len(content)
    header = struct.pack(">I4sI4s4s4s", at, b"lcms", 0x04300000, b"mntr", colours, b"XYZ ")
    header += bytes(12) + b"acsp" + bytes(28) + _fixed(0.9642, 1, 0.8249)
    return b"".join([header.ljust(128, b"\0"), struct.pack(">I", len(tags)), table, *tags.values()])


def _fixed(*values: float) -> bytes:
    return struct.pack(f">{len(values)}i", *(round(65536 * value) for value in values))


def camera_exif(
    *, colour_space: int | None = None, index: str | None = None, orientation: int | None = None
) -> Image.Exif:
    """What a camera says of colour: EXIF's ColorSpace and its interoperability index."""
    exif, inner = Image.Exif(), {}
    if colour_space is not None:
        inner[ExifTags.Base.ColorSpace] = colour_space
    if index is not None:
        inner[ExifTags.IFD.Interop] = {1: index}
    if inner:
        exif[ExifTags.IFD.Exif] = inner
    if orientation is not None:
        exif[ExifTags.Base.Orientation] = orientation
    return exif


def write_tiff(path: Path, codes: np.ndarray, exif: Image.Exif) -> Path:
    """A TIFF with what :func:`camera_exif` made, in directories behind the picture."""
    tifffile.imwrite(path, codes, photometric="rgb", extratags=[(65000, 4, 1, 0, True)])
    told, at = exif.get(ExifTags.IFD.Exif, {}), path.stat().st_size
    entries = []
    if ExifTags.Base.ColorSpace in told:
        entries.append((ExifTags.Base.ColorSpace, 3, 1, told[ExifTags.Base.ColorSpace]))
    index = told.get(ExifTags.IFD.Interop)
    if index is not None:
        entries.append((ExifTags.IFD.Interop, 4, 1, at + 6 + 12 * (len(entries) + 1)))
    content = _directory(entries)
    if index is not None:
        letters = int.from_bytes(index[1].encode() + b"\0", "little")
        content += _directory([(1, 2, 4, letters)])
    # tifffile does not write this tag itself, so that another stands for it
    stood, wanted = (struct.pack("<HHII", tag, 4, 1, to) for tag, to in ((65000, 0), (34665, at)))
    picture = path.read_bytes()
    assert picture.count(stood) == 1
    path.write_bytes(picture.replace(stood, wanted) + content)
    return path


def _directory(entries: list[tuple[int, int, int, int]]) -> bytes:
    """An image file directory (TIFF 6.0, section 2), little-endian, the last of its kind."""
    rows = b"".join(struct.pack("<HHII", *entry) for entry in entries)
    return struct.pack("<H", len(entries)) + rows + bytes(4)


def write_bitmap(path: Path, codes: np.ndarray, ends: np.ndarray, gamma: float) -> Path:
    """A bitmap whose header of version 4 tells XYZ of its primaries (rows) and a gamma."""
    height, width, _ = codes.shape
    pixels = codes[::-1, :, ::-1].tobytes()
    assert 3 * width % 4 == 0  # rows are padded to 4 bytes
    header = struct.pack("<IiiHHIIiiII", 108, width, height, 1, 24, 0, len(pixels), 0, 0, 0, 0)
    header += bytes(16) + bytes(4)  # masks; LCS_CALIBRATED_RGB
    header += struct.pack("<9i", *np.rint(ends.ravel() * 2**30).astype(int))
    header += struct.pack("<3I", *[round(gamma * 65536)] * 3)
    file = struct.pack("<2sIHHI", b"BM", 14 + 108 + len(pixels), 0, 0, 14 + 108)
    path.write_bytes(file + header + pixels)
    return path
