"""Photographs, boards and masks of 8 and 16 bits, with EXIF data and declared colours."""

import math
import struct
import zlib

import cv2
import numpy as np
import tifffile
from PIL import ExifTags, Image

from skylight.imaging._photo import read_photo
from skylight.object._files import read_mask
from skylight.probes.cameras._live import read_picture
from tests.fuzz.files import as_file, is_refused, written
from tests.imaging.picture_files import icc_profile, write_png

_PNG = b"\x89PNG\r\n\x1a\n"


def seeds() -> list[bytes]:
    codes = np.random.default_rng(0).integers(0, 256, (33, 40, 3), dtype=np.uint8)
    picture = Image.fromarray(codes)
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    tags = exif.get_ifd(ExifTags.IFD.Exif)
    tags[ExifTags.Base.FocalLengthIn35mmFilm] = 50
    tags[ExifTags.Base.ExposureTime] = 0.01
    tags[ExifTags.Base.FNumber] = 2.8
    tags[ExifTags.Base.ISOSpeedRatings] = 200
    deep = codes.astype(np.uint16) * 257
    planar = {"photometric": "rgb", "planarconfig": "separate"}
    profile = b"p\0\0" + zlib.compress(icc_profile(np.eye(3), 2.2))
    return [
        written("a.jpg", lambda path: picture.save(path, quality=60, exif=exif)),
        written("b.jpg", lambda path: picture.save(path, progressive=True)),
        written("c.png", lambda path: picture.save(path, exif=exif)),
        written("d.png", lambda path: picture.convert("P").save(path)),
        written("e.png", lambda path: cv2.imwrite(str(path), deep)),
        written("f.tif", lambda path: picture.save(path)),
        written("g.tif", lambda path: picture.save(path, compression="tiff_lzw")),
        written("h.tif", lambda path: cv2.imwrite(str(path), deep)),
        written("i.webp", lambda path: picture.save(path)),
        written("j.avif", lambda path: picture.save(path)),
        written("k.tif", lambda path: tifffile.imwrite(path, np.moveaxis(deep, -1, 0), **planar)),
        written("l.png", lambda path: write_png(path, deep, chunks={b"cICP": b"\x09\x10\0\1"})),
        written("m.png", lambda path: write_png(path, codes, chunks={b"iCCP": profile})),
    ]


def read(content: bytes) -> None:
    """A PNG's checksums are put right, or nothing behind them would ever be read."""
    path = as_file(_checked(content) if content.startswith(_PNG) else content, "photo.jpg")
    is_refused(lambda: read_picture(path))
    is_refused(lambda: read_mask(path))
    photo = read_photo(path)
    assert bool(photo.pixels.isfinite().all())
    if photo.camera_exposure is not None:
        assert math.isfinite(photo.camera_exposure.value)
        assert 0 < photo.camera_exposure.cd_per_m2 < math.inf


def _checked(content: bytes) -> bytes:
    out, place = bytearray(content), len(_PNG)
    while place + 12 <= len(out):
        (length,) = struct.unpack_from(">I", out, place)
        end = place + 8 + length
        if end + 4 > len(out):
            break
        struct.pack_into(">I", out, end, zlib.crc32(out[place + 4 : end]))
        place = end + 4
    return bytes(out)
