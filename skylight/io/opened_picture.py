"""Image files opened with Pillow: formats, size limits, one-line errors."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from skylight.errors import InputError, SkylightError
from skylight.io.bounded import require_bytes, require_pixels
from skylight.io.hdr import muted

# what cameras and programs write, decoded within the process; Pillow knows some that start others
FORMATS = ("JPEG", "PNG", "TIFF", "WEBP", "BMP", "GIF")
# our own limit on the size is the one that counts, and has a clearer message
warnings.filterwarnings("ignore", category=Image.DecompressionBombWarning)
# so has what cannot be in EXIF data
warnings.filterwarnings("ignore", module=r"PIL\.TiffImagePlugin")


@contextmanager
def opened_picture(path: Path) -> Iterator[Image.Image]:
    """A picture whose header was read and whose size is bounded; decode it within the block.

    Raises
    ------
    InputError
        The file is missing, damaged (which may show within the block), of another kind, or too
        large: more than ``PIXELS_MAX`` pixels or ``FILE_BYTES_MAX`` bytes.
    """
    try:
        require_bytes(path)
        with Image.open(path, formats=FORMATS) as image:
            try:
                require_pixels(*image.size)
            except ValueError as error:
                raise InputError(f"{path}: {error}; scale it down") from error
            with muted() if image.format == "TIFF" else nullcontext():
                yield image  # libtiff prints what it dislikes
    except SkylightError:
        raise
    except UnidentifiedImageError as error:
        raise InputError(f"{path}: no picture known here; give a JPEG, PNG or TIFF") from error
    except Image.DecompressionBombError as error:
        raise InputError(f"{path}: the picture is too large; scale it down") from error
    # Pillow's decoders raise whatever their parsing stumbles over
    except Exception as error:
        if reason := getattr(error, "strerror", None):
            raise InputError(f"cannot read {path}: {reason}; give a JPEG, PNG or TIFF") from error
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: damaged or cut short ({reason}); export it again") from error
