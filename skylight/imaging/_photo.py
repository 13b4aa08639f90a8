"""Photographs: strict reading, linear Rec.709 pixels, and camera metadata.

Pictures are opened by :mod:`skylight.imaging._pictures`, OpenEXR and Radiance files by
:mod:`skylight.io._hdr`, and cameras' RAW files developed by LibRaw (the extra ``raw``).
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8, UInt16
from PIL import Image
from torch import Tensor

from skylight.errors import InputError, not_installed
from skylight.imaging._capture_metadata import CaptureMetadata
from skylight.imaging._colour import Decode, decode_values, linear_to_srgb, tone_map
from skylight.imaging._encoding import Encoding, ProfileTables
from skylight.imaging._exif import CameraFacts, camera_facts, tiff_exif
from skylight.imaging._exposure import CameraExposure
from skylight.imaging._pictures import PICTURE_SUFFIXES, StoredPicture, stored_picture
from skylight.io._bounded import require_bytes, require_pixels
from skylight.io._hdr import SUFFIXES as HDR_SUFFIXES
from skylight.io._light import read_linear
from skylight.io._muted import muted
from skylight.sphere._envmap import luminance

RAW_SUFFIXES = (
    ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw",
)  # fmt: skip
PHOTO_SUFFIXES = frozenset({*PICTURE_SUFFIXES, *HDR_SUFFIXES, *RAW_SUFFIXES})
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


SIDE_MIN = 32
SIDE_MAX = 16_384
GREY_CODES = 2  # channels closer than this everywhere carry no colour (JPEG rounds by 1)
_BLOCK_ROWS = 64


@dataclass(frozen=True, kw_only=True)
class Photo:
    """A photograph, upright as its EXIF orientation asks.

    * ``pixels``: linear Rec.709; 1 is the white of the file's encoding, in sRGB the largest code
      value. HDR pictures and colours outside Rec.709 exceed it (.exr, .hdr and TIFF in floating
      point: as stored).
    * ``encoded``: the same picture as 8-bit sRGB, for detectors and for looking at.
    * ``clipped``: where a channel reached its largest code value, so more light may have fallen.
    * ``grey``: without colour: the three channels of ``pixels`` are equal.
    * ``focal_px``: focal length in pixels of this picture, None where the file does not tell.
    * ``flash``: whether it fired, None where the file does not tell.
    * ``camera_exposure``: exposure time, f-number and ISO, None where the file does not tell;
      ``exposure_value`` is that of the scene at ISO 100.
    * ``taken``: where and when, as far as the file tells.
    """

    pixels: Float[Tensor, "h w 3"]
    encoded: UInt8[np.ndarray, "h w 3"]
    clipped: Bool[Tensor, "h w"]
    grey: bool = False
    focal_px: float | None = None
    flash: bool | None = None
    camera_exposure: CameraExposure | None = None
    taken: CaptureMetadata | None = None

    @property
    def exposure_value(self) -> float | None:
        """How bright the scene was that the exposure was chosen for: that of ISO 100."""
        return None if self.camera_exposure is None else self.camera_exposure.value


def read_photo(
    path: str | Path, *, decode: Decode | None = None, require_colour: bool = False
) -> Photo:
    """A JPEG, PNG, TIFF, WebP, BMP, AVIF, HEIC, .exr, .hdr or RAW (.dng, ...) photograph.

    Parameters
    ----------
    decode
        How values encode light: "srgb" (default), "linear" (default for .exr, .hdr and TIFF in
        floating point) or the exponent of a power law. What a file declares instead of sRGB (see
        :mod:`skylight.imaging._encoding`) is followed where ``decode`` is left out or "srgb"; an
        explicit "linear" or exponent overrules it. PQ's and HLG's 1 is HDR reference white
        (203 cd/m2, BT.2408); HLG's light is the scene's.
    require_colour
        Refuse grey pictures, for what colour is essential to.

    Transparency is ignored: hidden pixels keep the colour that the file stores for them, and
    premultiplied ones are divided by alpha. Of a phone's multi-picture JPEG (MPO) or HEIC the
    first picture counts, of a TIFF the one that is no thumbnail.

    Raises
    ------
    DependencyError
        A RAW file without rawpy, which the extra ``raw`` installs, or HEIC without pillow-heif,
        which ``heif`` does.
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
        photo = _from_picture(path, decode)
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
    path: Path, decode: Decode | None
) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """(linear light, where it is saturated) of a picture, or of a RAW file, whatever ``decode``.

    As :func:`read_photo`, but as dark as may be and with whatever colour: one of several exposures
    may show nothing.
    """
    if path.suffix.lower() in RAW_SUFFIXES:
        codes, clipped = develop(path)
        return codes.astype(np.float32) / np.float32(65535), clipped
    with stored_picture(path) as picture:
        pixels, _, clipped = _decoded(path, picture, decode)
    return pixels, clipped


def read_exif(path: Path) -> Image.Exif:
    """The EXIF data of a picture or RAW file; empty where it has none."""
    if path.suffix.lower() in RAW_SUFFIXES:
        return tiff_exif(path)
    with stored_picture(path) as picture:
        return picture.exif()


def read_codes(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    """A picture as 8-bit sRGB, upright, whatever its size, colour and brightness."""
    with stored_picture(path) as picture:
        return _decoded(path, picture, None)[1]


def _from_linear_file(path: Path, decode: Decode) -> Photo:
    stored = read_linear(path)
    _check_size(path, stored.shape[1], stored.shape[0])
    _require_finite(path, stored)
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
    facts = camera_facts(tiff_exif(path), width, height)
    # a RAW file is exposed for its highlights, so what detectors see is brightened
    return _with_facts(pixels, tone_map(pixels), torch.from_numpy(clipped), facts)


def _from_picture(path: Path, decode: Decode | None) -> Photo:
    with stored_picture(path) as picture:
        _check_size(path, picture.width, picture.height)
        if picture.depth == 1:
            raise InputError(
                f"{path}: it has one bit a pixel, black or white, and no shades; give a photo"
            )
        facts = camera_facts(picture.exif(), picture.width, picture.height)
        pixels, encoded, clipped = _decoded(path, picture, decode)
    return _with_facts(torch.from_numpy(pixels), encoded, torch.from_numpy(clipped), facts)


def _decoded(
    path: Path, picture: StoredPicture, decode: Decode | None
) -> tuple[Float[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """(linear light, the same as 8-bit sRGB, where a code is the largest), as declared."""
    encoding = picture.encoding() if decode in (None, "srgb") else None
    codes = picture.codes()
    if codes.dtype == np.float32:
        _require_finite(path, codes)
        if isinstance(encoding, ProfileTables):
            raise InputError(f"{path}: {_NO_TABLES}")
        if encoding is None:
            light = decode_values(torch.from_numpy(codes), decode or "linear").numpy()
        else:
            light = encoding.linear(codes).astype(np.float32)
        light = light.clip(min=0)
        return light, tone_map(torch.from_numpy(light)), np.zeros(codes.shape[:2], bool)
    clipped = _at_maximum(codes)
    if isinstance(encoding, ProfileTables):
        if codes.dtype != np.uint8:
            raise InputError(f"{path}: {_NO_TABLES}")
        try:
            codes = encoding.to_srgb(codes)
        except ValueError as error:
            raise InputError(f"{path}: {error}") from error
        clipped |= _at_maximum(codes)  # colours too saturated for sRGB are cut there
        encoding = None
    light, encoded = _light(codes, decode or "srgb", encoding)
    return light, encoded, clipped


_NO_TABLES = (
    "its colour profile tells colours by tables, which are applied to 8 bits alone; convert it to "
    "sRGB, or say how it is encoded (linear, or a gamma)"
)


def _photo(
    codes: np.ndarray, decode: Decode, clipped: Bool[np.ndarray, "h w"], facts: CameraFacts
) -> Photo:
    pixels, encoded = _light(codes, decode, None)
    return _with_facts(torch.from_numpy(pixels), encoded, torch.from_numpy(clipped), facts)


def _light(
    codes: np.ndarray, decode: Decode, encoding: Encoding | None
) -> tuple[Float[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]:
    """(light, 8-bit sRGB) of uint8 or uint16 codes (h,w,3), by a table of all codes.

    ``encoding``, where there is one, in place of ``decode``. Below 0 are colours outside Rec.709,
    which are cut; what is brighter than white is kept in the light.
    """
    largest = np.iinfo(codes.dtype).max
    pixels, encoded = np.empty(codes.shape, np.float32), np.empty(codes.shape, np.uint8)
    if encoding is None:
        levels = torch.arange(largest + 1, dtype=torch.float32) / largest
        linear = decode_values(levels, decode)
        srgb = (255 * linear_to_srgb(linear)).round().to(torch.uint8).numpy()
    else:
        shares = np.arange(largest + 1) / largest
        curves = encoding.curve(np.stack([shares] * 3, -1)).T.astype(np.float32)
        matrix = encoding.to_rec709.astype(np.float32)
    for start in range(0, len(codes), _BLOCK_ROWS):  # numpy makes 8 bytes of each index
        rows = slice(start, start + _BLOCK_ROWS)
        if encoding is None:
            np.take(linear.numpy(), codes[rows], out=pixels[rows], mode="clip")
            np.take(srgb, codes[rows], out=encoded[rows], mode="clip")
        else:
            native = [curves[k].take(codes[rows, :, k], mode="clip") for k in range(3)]
            np.maximum(cv2.transform(np.stack(native, -1), matrix), 0, out=pixels[rows])
            shown = linear_to_srgb(torch.from_numpy(pixels[rows]).clamp(max=1))
            encoded[rows] = (255 * shown).round().to(torch.uint8).numpy()
    return pixels, encoded


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


def _require_finite(path: Path, pixels: np.ndarray) -> None:
    if not np.isfinite(pixels).all():
        raise InputError(f"{path}: it holds NaN or infinite pixels; repair or replace them")


def _is_grey(codes: UInt8[np.ndarray, "h w 3"]) -> bool:
    # channel by channel: numpy reduces an axis of 3 ten times slower
    red, green, blue = np.moveaxis(codes, -1, 0)
    highest = np.maximum(np.maximum(red, green), blue)
    return int((highest - np.minimum(np.minimum(red, green), blue)).max()) <= GREY_CODES


def _at_maximum(codes: np.ndarray) -> Bool[np.ndarray, "h w"]:
    red, green, blue = np.moveaxis(codes == np.iinfo(codes.dtype).max, -1, 0)
    return red | green | blue
