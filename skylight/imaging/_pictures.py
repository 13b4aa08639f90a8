"""Still pictures as their files store them: codes, upright, and what these say of colour.

Two decoders share the work so that each reads what it reads rightly: OpenImageIO TIFF, and PNG of
16 bits; Pillow all else, AVIF included, and HEIC through the extra ``heif``.
"""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image, UnidentifiedImageError

from skylight.errors import InputError, SkylightError, not_installed
from skylight.imaging._encoding import (
    Encoding,
    ProfileTables,
    bitmap_space,
    encoding_of,
    exif_space,
    nclx_space,
    png_space,
    transfer_tables,
)
from skylight.imaging._exif import tiff_exif
from skylight.io._bounded import require_bytes, require_size
from skylight.io._muted import muted
from skylight.io._tiff import is_floating, photometric, stored_samples, tiff_page, upright

# what folders of photographs are looked through for, besides RAW and HDR files
PICTURE_SUFFIXES = (
    ".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".tif", ".tiff", ".webp", ".bmp", ".gif", ".avif",
    ".heic", ".heif", ".hif",
)  # fmt: skip
_KNOWN = "give a JPEG, PNG or TIFF"
# what cameras and programs write, decoded within the process; Pillow knows some that start others
_FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "GIF", "AVIF")
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_HEIF = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")
_GREY_MODES = ("1", "L", "LA", "I;16", "I;16B", "I;16L")
_RGB_MODES = ("RGB", "RGBA", "RGBX", "P", "PA")
# TIFF 6.0, section 8, and what came later
_COLOURS = {5: "CMYK", 8: "LAB", 9: "LAB", 10: "LAB", 32803: "RAW", 32844: "LogL", 32845: "LogLuv"}
# compressions of TIFF that OpenImageIO's wheels cannot undo; Pillow can, but of 8 bits alone
_PILLOWS = {34887: "LERC", 34925: "LZMA", 50000: "zstd", 50001: "WebP"}
_PALETTE = 3
# our own limit on the size is the one that counts, and has a clearer message
warnings.filterwarnings("ignore", category=Image.DecompressionBombWarning)
# so has what cannot be in EXIF data
warnings.filterwarnings("ignore", module=r"PIL\.TiffImagePlugin")


@dataclass(frozen=True, kw_only=True)
class StoredPicture:
    """A picture whose header was read; what fails later is told as :func:`stored_picture` does.

    ``width``, ``height``  as stored, before the orientation is followed.
    ``depth``     bits of a code, 32 for floating point; 1 for black and white.
    ``exif``      what the camera told, or nothing; of a PNG without any it decodes.
    ``codes``     decodes: uint8, uint16 or float32 (h, w, 3), upright, transparency left out.
    ``encoding``  looks up how the codes encode light; None for sRGB.
    """

    width: int
    height: int
    depth: int
    exif: Callable[[], Image.Exif]
    codes: Callable[[], np.ndarray]
    encoding: Callable[[], Encoding | ProfileTables | None]


@contextmanager
def stored_picture(path: Path) -> Iterator[StoredPicture]:
    """A picture of bounded size, to be decoded within the block.

    Of a phone's multi-picture JPEG or HEIC the first or primary picture counts, of a TIFF the one
    that is no thumbnail. Premultiplied colours are divided by alpha; where alpha is 0 they stay.

    Raises
    ------
    DependencyError
        A HEIC file without pillow-heif, which the extra ``heif`` installs.
    InputError
        The file is missing, damaged (which may show within the block), of another kind, animated,
        neither RGB nor grey, or too large: more than ``PIXELS_MAX`` pixels or ``FILE_BYTES_MAX``
        bytes.
    """
    try:
        require_bytes(path)
        with path.open("rb") as stream:
            head = stream.read(32)
        if head.startswith(_TIFF):
            with muted():
                yield _tiff(path)
        else:
            with Image.open(path, formats=_formats(path, head)) as image:
                require_size(path, *image.size)
                yield _plain(path, image, deep=image.format == "PNG" and head[24] == 16)
    except (SkylightError, NameError, AssertionError, ImportError):  # these are no picture's
        raise
    except UnidentifiedImageError as error:
        raise InputError(f"{path}: no picture known here; {_KNOWN}") from error
    except Image.DecompressionBombError as error:
        raise InputError(f"{path}: the picture is too large; scale it down") from error
    # Pillow's decoders raise whatever their parsing stumbles over
    except Exception as error:
        if reason := getattr(error, "strerror", None):
            raise InputError(f"cannot read {path}: {reason}; {_KNOWN}") from error
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: damaged or cut short ({reason}); export it again") from error


def picture_size(path: Path) -> tuple[int, int]:
    """(width, height) as stored; raises as :func:`stored_picture`."""
    with stored_picture(path) as picture:
        return picture.width, picture.height


def _formats(path: Path, head: bytes) -> tuple[str, ...]:
    if head[4:8] != b"ftyp" or head[8:12] not in _HEIF or b"avif" in head:
        return _FORMATS
    try:
        from pillow_heif import register_heif_opener
    except ImportError as error:
        raise not_installed("pillow_heif", f"{path}: a HEIC picture") from error
    register_heif_opener()
    return ("HEIF",)


def _plain(path: Path, image: Image.Image, *, deep: bool) -> StoredPicture:
    """What Pillow opened; of 16 bits a channel OpenImageIO decodes it."""
    if getattr(image, "n_frames", 1) > 1 and image.format not in ("MPO", "HEIF"):
        raise InputError(f"{path}: it holds several pictures; save one of them as JPEG or PNG")
    if image.mode not in (*_GREY_MODES, *_RGB_MODES):
        raise InputError(f"{path}: its colours are {image.mode}; convert it to RGB (sRGB)")
    exif = cache(image.getexif)

    def codes() -> np.ndarray:
        if deep:
            with muted():
                stored = _by_openimageio(path)
        else:
            stored = np.array(image.convert("RGB"))
        return upright(stored, exif().get(ExifTags.Base.Orientation, 1))

    def encoding() -> Encoding | ProfileTables | None:
        profile, space = image.info.get("icc_profile"), exif_space(exif())
        with _reasons(path), path.open("rb") as stream:
            if image.format == "PNG":
                told, is_first = png_space(stream)
                profile, space = (None if is_first else profile), told or space
            elif image.format in ("AVIF", "HEIF"):
                space = nclx_space(stream) or space
            elif image.format == "BMP":
                profile, space = bitmap_space(stream)
            return encoding_of(profile, space)

    return StoredPicture(
        width=image.width,
        height=image.height,
        depth=1 if image.mode == "1" else 16 if deep else 8,
        exif=exif,
        codes=codes,
        encoding=encoding,
    )


def _tiff(path: Path) -> StoredPicture:
    """The page of a TIFF that is no thumbnail, decoded by OpenImageIO where that can."""
    page, spec = tiff_page(path)
    colours = photometric(spec)
    compression = spec.get_int_attribute("tiff:Compression", 1)
    bits = spec.get_int_attribute("oiio:BitsPerSample", 8 * spec.format.size())
    if colours in _COLOURS:
        raise InputError(f"{path}: its colours are {_COLOURS[colours]}; convert it to RGB (sRGB)")
    if str(spec.format) in ("int8", "int16", "int", "int64", "uint64"):
        raise InputError(f"{path}: its values are {spec.format}; export it with 8 or 16 bits")
    if compression in _PILLOWS and bits != 8:
        raise InputError(
            f"{path}: a TIFF of {bits} bits compressed by {_PILLOWS[compression]} is not read; "
            "export it uncompressed, or with LZW or deflate"
        )

    def codes() -> np.ndarray:
        # colour maps hold 8-bit values times 256 or 257; OpenImageIO divides all by 257
        if compression in _PILLOWS or (colours == _PALETTE and bits <= 8):
            with Image.open(path, formats=("TIFF",)) as image:
                image.seek(page)
                stored = np.array(image.convert("RGB"))
        else:
            stored = _by_openimageio(path, page)
            # OpenImageIO turns negatives of 8 bits and fewer into positives, and no others
            if colours == 0 and stored.dtype == np.uint16:
                stored = 65535 - stored
        return upright(stored, spec.get_int_attribute("Orientation", 1))

    def encoding() -> Encoding | ProfileTables | None:
        profile = spec.getattribute("ICCProfile")
        with _reasons(path):
            return encoding_of(
                None if profile is None else bytes(profile),
                transfer_tables(exif()) or exif_space(exif()),
            )

    exif = cache(lambda: tiff_exif(path))
    depth = 32 if is_floating(spec) else min(bits, 16)
    return StoredPicture(
        width=spec.width,
        height=spec.height,
        depth=depth,
        exif=exif,
        codes=codes,
        encoding=encoding,
    )


def _by_openimageio(path: Path, page: int = 0) -> np.ndarray:
    """Codes (h,w,3), not turned: uint8, uint16 or float32."""
    colours, alpha, is_premultiplied = stored_samples(path, page)
    if alpha is not None and is_premultiplied:
        colours = _straight(colours, alpha)
    return np.repeat(colours, 3, -1) if colours.shape[-1] == 1 else np.ascontiguousarray(colours)


def _straight(colours: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Premultiplied colours over their alpha; where that is 0 they stay."""
    if colours.dtype.kind == "f":
        return np.divide(colours, alpha, out=colours.copy(), where=alpha > 0)
    largest = np.iinfo(colours.dtype).max
    over = colours.astype(np.float32) * (largest / np.maximum(alpha, 1).astype(np.float32))
    straight = np.rint(np.minimum(over, largest)).astype(colours.dtype)
    return np.where(alpha > 0, straight, colours)


@contextmanager
def _reasons(path: Path) -> Iterator[None]:
    """A declaration that is not understood is no damage."""
    try:
        yield
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
