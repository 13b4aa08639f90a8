"""Photographs: strict reading, linear Rec.709 pixels, and camera metadata.

Pictures are opened by Pillow, OpenEXR and Radiance files by :mod:`skylight.io._hdr`, and cameras'
RAW files developed by LibRaw (the extra ``raw``).
"""

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8, UInt16
from PIL import Image, ImageCms, ImageOps
from torch import Tensor

from skylight.errors import InputError, not_installed
from skylight.imaging._capture_metadata import CaptureMetadata
from skylight.imaging._colour import Decode, decode_values, linear_to_srgb, tone_map
from skylight.imaging._exif import CameraFacts, camera_facts
from skylight.io._bounded import file_bytes, require_bytes, require_pixels
from skylight.io._files import opened_picture
from skylight.io._hdr import SUFFIXES as HDR_SUFFIXES
from skylight.io._light import read_linear
from skylight.io._muted import muted
from skylight.sphere._envmap import luminance

RAW_SUFFIXES = (
    ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw",
)  # fmt: skip
_TIFF = (b"II*\0", b"MM\0*")
_QUARTER_TURNS = {0: 0, 3: 2, 5: 1, 6: 3}  # LibRaw's flips, as counter-clockwise turns


def develop(path: Path) -> tuple[UInt16[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """(linear codes in the camera's white balance, where the sensor was saturated), upright.

    65535 is the sensor's white level; nothing is brightened. Saturated are pixels at the white
    level and their neighbours, to which demosaicing spreads them.
    """
    try:
        import rawpy
    except ImportError as error:
        raise not_installed("rawpy", f"{path}: a RAW file") from error
    try:
        require_bytes(path)
        with muted(), rawpy.imread(str(path)) as raw:  # LibRaw prints what it dislikes
            require_pixels(raw.sizes.width, raw.sizes.height)
            require_pixels(raw.sizes.raw_width, raw.sizes.raw_height)  # with what is not shown
            sensor = raw.raw_image_visible
            saturated = (sensor >= raw.white_level).reshape(*sensor.shape[:2], -1).any(2)
            turns = _QUARTER_TURNS.get(raw.sizes.flip, 0)
            codes = raw.postprocess(
                gamma=(1, 1),
                no_auto_bright=True,
                output_bps=16,
                use_camera_wb=True,
                output_color=rawpy.ColorSpace.sRGB,
                user_flip=0,
            )
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}; give a photograph") from error
    except (rawpy.LibRawError, ValueError) as error:
        reason = error.args[0] if error.args else type(error).__name__
        if isinstance(reason, bytes):
            reason = reason.decode("ascii", "replace")
        raise InputError(f"{path}: no RAW file that can be read ({reason})") from error
    if codes.shape[2] == 1:  # a sensor without colour filters
        codes = codes.repeat(3, 2)
    spread = cv2.dilate(np.asarray(saturated, np.uint8), np.ones((3, 3), np.uint8))
    height, width = codes.shape[:2]
    # of sensors whose pixels are not square the picture has another size
    spread = cv2.resize(spread, (width, height), interpolation=cv2.INTER_NEAREST)
    upright = np.ascontiguousarray(np.rot90(codes, turns))
    return upright, np.ascontiguousarray(np.rot90(spread > 0, turns))


def raw_exif(path: Path) -> Image.Exif:
    """The EXIF data of a RAW file that is built as a TIFF file is; none of others."""
    exif, content = Image.Exif(), file_bytes(path)
    if content.startswith(_TIFF):
        exif.load(b"Exif\0\0" + content)
    return exif


SIDE_MIN = 32
SIDE_MAX = 16_384
GREY_CODES = 2  # channels closer than this everywhere carry no colour (JPEG rounds by 1)
GREY_MODES = ("L", "LA", "La", "I;16", "I;16B", "I;16L")  # Pillow's, of 8 and 16 bits
_BLOCK_ROWS = 64


@dataclass(frozen=True, kw_only=True)
class Photo:
    """A photograph, upright as its EXIF orientation asks.

    ``pixels``   linear Rec.709; 1 is the largest code value (.exr and .hdr: as stored).
    ``encoded``  the same picture as 8-bit sRGB, for detectors and for looking at.
    ``clipped``  where a channel reached its largest code value, so more light may have fallen.
    ``grey``     without colour: the three channels of ``pixels`` are equal.
    ``focal_px`` focal length in pixels of this picture, None where the file does not tell.
    ``flash``    whether it fired, None where the file does not tell.
    ``exposure_value``  that of the scene at ISO 100, None where the file does not tell.
    ``taken``    where and when, as far as the file tells.
    """

    pixels: Float[Tensor, "h w 3"]
    encoded: UInt8[np.ndarray, "h w 3"]
    clipped: Bool[Tensor, "h w"]
    grey: bool = False
    focal_px: float | None = None
    flash: bool | None = None
    exposure_value: float | None = None
    taken: CaptureMetadata | None = None


def read_photo(
    path: str | Path, *, decode: Decode | None = None, require_colour: bool = False
) -> Photo:
    """A JPEG, PNG, TIFF (8 or 16 bit a channel), .exr, .hdr or RAW (.dng, ...) photograph.

    Parameters
    ----------
    decode
        How values encode light: "srgb" (default), "linear" (default for .exr and .hdr) or the
        exponent of a power law. An embedded colour profile other than sRGB is converted to sRGB
        where ``decode`` is left out or "srgb"; an explicit "linear" or exponent overrules it.
    require_colour
        Refuse grey pictures, for what colour is essential to.

    Transparency is ignored: hidden pixels keep the colour that the file stores for them. Of a
    phone's multi-picture JPEG (MPO) the first picture counts.

    Raises
    ------
    DependencyError
        A RAW file without rawpy, which the extra ``raw`` installs.
    InputError
        No readable still picture from 32 to 16384 pixels a side and up to 134 megapixels:
        missing, damaged, animated, CMYK, black, of one bit a pixel, or grey against the wish.
    """
    path = Path(path)
    if path.suffix.lower() in RAW_SUFFIXES:
        photo = _from_raw(path, decode)
    elif path.suffix.lower() in HDR_SUFFIXES:
        photo = _from_linear_file(path, "linear" if decode is None else decode)
    else:
        photo = _from_picture(path, "srgb" if decode is None else decode)
    if photo.encoded.max() <= GREY_CODES:
        raise InputError(f"{path}: the picture is black; give a photo that shows a lit face")
    if require_colour and photo.grey:
        raise InputError(
            f"{path}: the picture is grey (red, green and blue are equal everywhere) and tells "
            "nothing about light's colour; give a colour photo"
        )
    return photo


def photo_from_codes(codes: UInt8[np.ndarray, "h w 3"], *, decode: Decode | None = None) -> Photo:
    """A photograph from its upright 8-bit codes; ``decode`` as in :func:`read_photo`.

    Raises
    ------
    InputError
        Codes of another type or shape, or a black picture.
    """
    if codes.dtype != np.uint8 or codes.ndim != 3 or codes.shape[2] != 3:
        raise InputError(
            f"a picture must be uint8 of shape (height, width, 3), got {codes.dtype} of "
            f"{codes.shape}; convert it, or make a Photo"
        )
    if codes.size and codes.max() <= GREY_CODES:
        raise InputError("the picture is black; give one that shows a lit face")
    return _photo(codes, "srgb" if decode is None else decode, _at_maximum(codes), CameraFacts())


def read_light(
    path: Path, decode: Decode
) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """(linear light, where it is saturated) of a picture, or of a RAW file, whatever ``decode``.

    As :func:`read_photo`, but as dark as may be and with whatever colour: one of several exposures
    may show nothing.
    """
    if path.suffix.lower() in RAW_SUFFIXES:
        codes, clipped = develop(path)
        return codes.astype(np.float32) / np.float32(65535), clipped
    with opened_picture(path) as image:
        _check_kind(path, image)
        codes, clipped, _ = _decode_picture(path, image, decode)
    share = codes.astype(np.float32) / np.float32(np.iinfo(codes.dtype).max)
    return decode_values(torch.from_numpy(share), decode).numpy(), clipped


def is_deep(image: Image.Image) -> bool:
    """Whether a picture that is not decoded yet has 16 bits a channel.

    Pillow cuts 16-bit colour down to 8; its plan of decoding, empty once done, tells.
    """
    return ";16" in str(getattr(image, "tile", ""))


def read_exif(path: Path) -> Image.Exif:
    """The EXIF data of a picture or RAW file; empty where it has none."""
    if path.suffix.lower() in RAW_SUFFIXES:
        return raw_exif(path)
    with opened_picture(path) as image:
        return image.getexif()


def _from_linear_file(path: Path, decode: Decode) -> Photo:
    stored = read_linear(path)
    _check_size(path, stored.shape[1], stored.shape[0])
    if not np.isfinite(stored).all():
        raise InputError(f"{path}: it holds NaN or infinite pixels; repair or replace them")
    # cameras' colour conversion leaves small negative values: colours outside Rec.709
    pixels = decode_values(torch.from_numpy(stored).clamp(min=0), decode)
    clipped = torch.zeros(pixels.shape[:2], dtype=torch.bool)
    return _with_facts(pixels, tone_map(pixels), clipped, CameraFacts())


def _from_raw(path: Path, decode: Decode | None) -> Photo:
    if decode not in (None, "linear"):
        raise InputError(f"{path}: RAW files hold linear light; leave its encoding out")
    codes, clipped = develop(path)
    height, width = codes.shape[:2]
    _check_size(path, width, height)
    pixels = torch.from_numpy(codes.astype(np.float32) / np.float32(65535))
    facts = camera_facts(raw_exif(path), width, height)
    # a RAW file is exposed for its highlights, so what detectors see is brightened
    return _with_facts(pixels, tone_map(pixels), torch.from_numpy(clipped), facts)


def _from_picture(path: Path, decode: Decode) -> Photo:
    with opened_picture(path) as image:
        _check_size(path, *image.size)
        _check_kind(path, image)
        codes, clipped, facts = _decode_picture(path, image, decode)
    return _photo(codes, decode, clipped, facts)


def _photo(
    codes: np.ndarray, decode: Decode, clipped: Bool[np.ndarray, "h w"], facts: CameraFacts
) -> Photo:
    """The picture that uint8 or uint16 codes (h,w,3) stand for, by a table of all codes."""
    largest = np.iinfo(codes.dtype).max
    levels = torch.arange(largest + 1, dtype=torch.float32) / largest
    linear = decode_values(levels, decode)
    srgb = (255 * linear_to_srgb(linear)).round().to(torch.uint8).numpy()
    pixels, encoded = np.empty(codes.shape, np.float32), np.empty(codes.shape, np.uint8)
    for start in range(0, len(codes), _BLOCK_ROWS):  # numpy makes 8 bytes of each index
        rows = slice(start, start + _BLOCK_ROWS)
        np.take(linear.numpy(), codes[rows], out=pixels[rows], mode="clip")
        np.take(srgb, codes[rows], out=encoded[rows], mode="clip")
    return _with_facts(torch.from_numpy(pixels), encoded, torch.from_numpy(clipped), facts)


def _with_facts(
    pixels: Float[Tensor, "h w 3"],
    encoded: UInt8[np.ndarray, "h w 3"],
    clipped: Bool[Tensor, "h w"],
    facts: CameraFacts,
) -> Photo:
    """With what the camera told; rounding's traces of colour are taken out of a grey picture."""
    grey = encoded.size > 0 and _is_grey(encoded)
    if grey:
        pixels = luminance(pixels)[..., None].repeat(1, 1, 3)
    return Photo(
        pixels=pixels,
        encoded=encoded,
        clipped=clipped,
        grey=grey,
        **vars(facts),
    )


def _check_size(path: Path, width: int, height: int) -> None:
    if min(width, height) < SIDE_MIN or max(width, height) > SIDE_MAX:
        raise InputError(
            f"{path}: {width}x{height} pixels; each side must have {SIDE_MIN} to {SIDE_MAX}"
        )


def _check_kind(path: Path, image: Image.Image) -> None:
    """Refuse, before decoding, what is no single RGB or grey picture."""
    if getattr(image, "n_frames", 1) > 1 and image.format != "MPO":
        raise InputError(f"{path}: it holds several pictures; save one of them as JPEG or PNG")
    if image.mode == "1":
        raise InputError(
            f"{path}: it has one bit a pixel, black or white, and no shades; give a photo"
        )
    if image.mode not in ("RGB", "RGBA", "RGBa", "RGBX", "P", "PA", *GREY_MODES):
        raise InputError(f"{path}: its colours are {image.mode}; convert it to RGB (sRGB)")


def _decode_picture(
    path: Path, image: Image.Image, decode: Decode
) -> tuple[np.ndarray, Bool[np.ndarray, "h w"], CameraFacts]:
    """(codes (h,w,3) uint8 or uint16, clipped, the camera's), upright and in sRGB's primaries."""
    deep = is_deep(image)
    facts = camera_facts(image.getexif(), *image.size)
    to_srgb = _profile_to_srgb(path, image) if decode == "srgb" else None
    if deep:
        if to_srgb is not None:
            raise InputError(
                f"{path}: 16-bit pictures are read in sRGB only, and its colour profile is "
                "another; convert it to sRGB, or say how it is encoded (linear, or a gamma)"
            )
        # these flags make OpenCV turn the picture upright; only from memory is it reliable
        data = np.frombuffer(file_bytes(path), np.uint8)
        bgr = cv2.imdecode(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
        if bgr is None:
            raise InputError(f"{path}: damaged or cut short; export it again")
        codes = np.ascontiguousarray(bgr[..., ::-1])
        return codes, _at_maximum(codes), facts
    upright = ImageOps.exif_transpose(image)
    upright = upright.convert("RGB" if to_srgb is None else to_srgb.input_mode)
    codes = np.array(upright.convert("RGB"))
    clipped = _at_maximum(codes)
    if to_srgb is not None:
        codes = np.array(ImageCms.applyTransform(upright, to_srgb))
        clipped |= _at_maximum(codes)  # colours too saturated for sRGB are cut there
    return codes, clipped, facts


def _is_grey(codes: UInt8[np.ndarray, "h w 3"]) -> bool:
    # channel by channel: numpy reduces an axis of 3 ten times slower
    red, green, blue = np.moveaxis(codes, -1, 0)
    highest = np.maximum(np.maximum(red, green), blue)
    return int((highest - np.minimum(np.minimum(red, green), blue)).max()) <= GREY_CODES


def _at_maximum(codes: np.ndarray) -> Bool[np.ndarray, "h w"]:
    red, green, blue = np.moveaxis(codes == np.iinfo(codes.dtype).max, -1, 0)
    return red | green | blue


def _profile_to_srgb(path: Path, image: Image.Image) -> ImageCms.ImageCmsTransform | None:
    """The conversion that an embedded profile asks for; None without one or where it is sRGB.

    Whether a profile is sRGB shows in what it does to a lattice of colours, not in its name.
    """
    profile = image.info.get("icc_profile")
    if not profile:
        return None
    # bytes 16 to 19 of a profile name its colour space (ICC.1:2022, 7.2.8)
    mode = "L" if image.mode in GREY_MODES and profile[16:20] == b"GRAY" else "RGB"
    try:
        transform = ImageCms.buildTransform(
            BytesIO(profile), ImageCms.createProfile("sRGB"), mode, "RGB"
        )
    except (ImageCms.PyCMSError, OSError) as error:
        raise InputError(f"{path}: its colour profile cannot be read; save as sRGB") from error
    steps = np.linspace(0, 255, 9).astype(np.uint8)
    codes = np.stack(np.meshgrid(steps, steps, steps), -1).reshape(9, 81, 3)
    lattice = Image.fromarray(codes).convert(mode)
    converted = np.asarray(ImageCms.applyTransform(lattice, transform), dtype=int)
    change = np.abs(converted - np.asarray(lattice.convert("RGB"), dtype=int)).max()
    return transform if change > 3 else None


PHOTO_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff", *HDR_SUFFIXES, *RAW_SUFFIXES})
