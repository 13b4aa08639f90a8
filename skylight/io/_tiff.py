"""TIFF files, and PNG of 16 bits, by OpenImageIO: as they are stored, and as light."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from skylight.errors import InputError
from skylight.io._bounded import PICTURE_BYTES_MAX, require_bytes, require_size
from skylight.io._colour_spaces import colour_space_named, converted
from skylight.io._exr import transparency
from skylight.io._muted import muted

_REDUCED, _MASK = 1, 4  # bits of TIFF's NewSubfileType
_PAGES_MOST = 200
_WHITE_IS_0, _BLACK_IS_0 = 0, 1  # TIFF 6.0, PhotometricInterpretation


@cache
def openimageio() -> Any:
    """The library, with one thread; on sizes our own limits count (slow to import)."""
    import OpenImageIO

    OpenImageIO.attribute("threads", 1)
    OpenImageIO.attribute("limits:imagesize_MB", 0)
    return OpenImageIO


def tiff_page(path: Path) -> tuple[int, Any]:
    """(number, header) of the one page that is neither a thumbnail nor a mask.

    Raises
    ------
    InputError
        Several such pages, one that is too large, or a kind of TIFF that is not read.
    ValueError
        A file that is damaged.
    """
    file = _opened(path)
    pages = []
    while len(pages) < _PAGES_MOST and file.seek_subimage(len(pages), 0):
        pages.append(file.spec())
    file.geterror()  # that there is none after the last
    pictures = [
        (number, spec)
        for number, spec in enumerate(pages)
        if not spec.get_int_attribute("tiff:subfiletype", 0) & (_REDUCED | _MASK)
    ]
    if len(pictures) != 1:
        raise InputError(f"{path}: it holds several pictures; save one of them alone")
    number, spec = pictures[0]
    require_size(path, spec.width, spec.height)
    if spec.image_bytes() > PICTURE_BYTES_MAX:
        raise InputError(f"{path}: its {spec.nchannels} channels are too large; scale it down")
    if photometric(spec) == _WHITE_IS_0 and is_floating(spec):
        raise InputError(f"{path}: floating point with white as 0 is not read; export black as 0")
    return number, spec


def photometric(spec: Any) -> int:
    """TIFF's PhotometricInterpretation; that of RGB for other files."""
    return spec.get_int_attribute("tiff:PhotometricInterpretation", 2)


def is_floating(spec: Any) -> bool:
    """Whether samples are half, single or double precision."""
    return str(spec.format) in ("half", "float", "double")


def stored_samples(
    path: Path, page: int = 0
) -> tuple[Shaped[np.ndarray, "h w c"], Shaped[np.ndarray, "h w 1"] | None, bool]:
    """(colours, alpha or None, whether it is multiplied in), not turned.

    uint8, uint16 or float32; ``c`` is 1 or 3. Raises as :func:`tiff_page`.
    """
    file, library = _opened(path), openimageio()
    file.seek_subimage(page, 0)
    spec = file.spec()
    kinds = {library.UINT8: library.UINT8, library.UINT16: library.UINT16}
    # of 32-bit integers OpenImageIO gives the share of the largest, in double precision
    kind = kinds.get(spec.format.basetype, library.FLOAT)
    wide = spec.format.basetype == library.UINT
    has_alpha = spec.alpha_channel > 0
    is_grey = spec.nchannels - has_alpha < 3
    if not is_grey and photometric(spec) in (_WHITE_IS_0, _BLACK_IS_0):
        raise InputError(f"{path}: it is grey and has further channels; export it as RGB or grey")
    channels = 1 if is_grey else 3
    stored = max(channels, spec.alpha_channel + 1)
    values = file.read_image(page, 0, 0, stored, library.DOUBLE if wide else kind)
    if values is None:
        raise _refusal(path, file.geterror())
    if wide:
        values = np.rint(65535 * values).astype(np.uint16)
    values = values.reshape(spec.height, spec.width, stored)
    alpha = values[..., spec.alpha_channel, None] if has_alpha else None
    is_premultiplied = has_alpha and not spec.get_int_attribute("oiio:UnassociatedAlpha", 0)
    return values[..., :channels], alpha, is_premultiplied


def upright(stored: Shaped[np.ndarray, "h w c"], orientation: object) -> np.ndarray:
    """Turned and mirrored as the tag of TIFF and EXIF asks (EXIF 2.32, Orientation)."""
    turns = {3: 2, 4: 2, 5: 3, 6: 3, 7: 1, 8: 1}.get(orientation, 0)  # type: ignore[call-overload]
    turned = np.rot90(stored, turns)
    mirrored = turned[:, ::-1] if orientation in (2, 4, 5, 7) else turned
    return np.ascontiguousarray(mirrored)


def read_tiff(path: Path) -> tuple[Float[np.ndarray, "h w 3"], list[str]]:
    """(linear Rec.709, what was done in words) of a TIFF file of floating point.

    Raises
    ------
    InputError, OSError, ValueError
        As :func:`tiff_page`; codes instead of light.
    """
    require_bytes(path)
    with muted():
        page, spec = tiff_page(path)
        if not is_floating(spec):
            raise ValueError(
                f"a TIFF file of {spec.format} codes, not of light; give one of float samples, or "
                "an .exr or .hdr file"
            )
        colours, alpha, _ = stored_samples(path, page)
    orientation = spec.get_int_attribute("Orientation", 1)
    colours = upright(colours, orientation)
    colours = np.repeat(colours, 3, -1) if colours.shape[-1] == 1 else colours
    space = colour_space_named(str(spec.getattribute("oiio:ColorSpace") or ""))
    pixels, notes = converted(colours, space)
    if spec.getattribute("ICCProfile") is not None:
        name = spec.get_string_attribute("ICCProfile:profile_description")
        told = f"its colour profile {name!r}" if name else "its colour profile"
        notes.append(f"{told} is not used: values count as linear Rec.709")
    if alpha is not None:
        notes += transparency(upright(alpha, orientation)[..., 0], pixels)
    return pixels, notes


def _opened(path: Path) -> Any:
    library = openimageio()
    as_stored = library.ImageSpec()
    as_stored.attribute("oiio:UnassociatedAlpha", 1)  # straight alpha is not multiplied in
    opened = library.ImageInput.open(str(path), as_stored)
    if opened is None:
        raise _refusal(path, library.geterror())
    return opened


def _refusal(path: Path, reason: str) -> Exception:
    """What is valid, but beyond the library, is not called damaged."""
    told = " ".join(reason.split())[:200]
    if any(word in reason.lower() for word in ("support", "can not handle", "sampleformat")):
        return InputError(f"{path}: a kind of TIFF that is not read ({told}); export it as RGB")
    return ValueError(told)
