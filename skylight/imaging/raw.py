"""Cameras' RAW files, developed to linear Rec.709 by LibRaw (the extra ``raw``)."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, UInt16
from PIL import Image

from skylight.errors import DependencyError, InputError
from skylight.io.bounded import file_bytes, require_bytes, require_pixels
from skylight.io.hdr import muted

RAW_SUFFIXES = (
    ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw",
)  # fmt: skip
_TIFF = (b"II*\0", b"MM\0*")
_QUARTER_TURNS = {0: 0, 3: 2, 5: 1, 6: 3}  # LibRaw's flips, as counter-clockwise turns


def develop(path: Path) -> tuple[UInt16[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """(linear codes in the camera's white balance, where the sensor was saturated), upright.

    65535 is the sensor's white level; nothing is brightened. Saturated are pixels at the white
    level and their neighbours, to which demosaicing spreads them.

    Raises
    ------
    DependencyError
        rawpy is not installed.
    InputError
        The file is missing, damaged, too large or of a camera that LibRaw does not know.
    """
    try:
        import rawpy
    except ImportError as error:
        raise DependencyError(
            f"{path}: RAW files need rawpy, which is not installed: pip install 'skylight[raw]'"
        ) from error
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
