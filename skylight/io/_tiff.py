"""Light from TIFF files of half, float or double samples, read by OpenImageIO."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from skylight.io._bounded import PICTURE_BYTES_MAX, require_bytes, require_pixels
from skylight.io._colour_spaces import colour_space_named, converted
from skylight.io._exr import transparency

# TIFF 6.0, orientation: whether rows and columns are exchanged, then rows and columns reversed
_TURNS = {
    1: (False, False, False), 2: (False, False, True), 3: (False, True, True),
    4: (False, True, False), 5: (True, False, False), 6: (True, False, True),
    7: (True, True, True), 8: (True, True, False),
}  # fmt: skip


def read_tiff(path: Path) -> tuple[Float[np.ndarray, "h w 3"], list[str]]:
    """(linear Rec.709, what was done in words) of the first picture in a TIFF file.

    Raises
    ------
    OSError, ValueError
        A file that cannot be opened, is damaged or too large, or holds codes instead of light.
    """
    import OpenImageIO  # takes long to load, and few maps are TIFF files

    require_bytes(path)
    asked = OpenImageIO.ImageSpec()
    asked.attribute("oiio:UnassociatedAlpha", 1)  # else colours would be multiplied by it
    source = OpenImageIO.ImageInput.open(str(path), asked)
    if source is None:
        raise ValueError(f"no TIFF file that is known here: {_words(OpenImageIO.geterror())}")
    try:
        spec = source.spec()
        if not str(spec.format).startswith(("half", "float", "double")):
            raise ValueError(
                f"a TIFF file of {spec.format} codes, not of light; give one of float samples, or "
                "an .exr or .hdr file"
            )
        require_pixels(spec.width, spec.height)
        if 4 * spec.width * spec.height * spec.nchannels > PICTURE_BYTES_MAX:
            raise ValueError(f"its {spec.nchannels} channels are too large")
        names = [name.upper() for name in spec.channelnames]
        if names[:3] == ["R", "G", "B"]:
            colours = [0, 1, 2]
        elif names[:1] in (["Y"], ["L"]):
            colours = [0, 0, 0]
        else:
            raise ValueError(f"expected the channels R, G, B or Y, got {', '.join(names[:8])}")
        stored = source.read_image(OpenImageIO.FLOAT)
        if stored is None:
            raise ValueError(f"its pixels cannot be decoded: {_words(source.geterror())}")
        several = source.seek_subimage(1, 0)
    finally:
        source.close()
    stored = stored.reshape(spec.height, spec.width, spec.nchannels)
    turned, rows, columns = _TURNS.get(spec.getattribute("Orientation") or 1, _TURNS[1])
    stored = stored.transpose(1, 0, 2) if turned else stored
    stored = stored[:: -1 if rows else 1, :: -1 if columns else 1]
    space = colour_space_named(str(spec.getattribute("oiio:ColorSpace") or ""))
    pixels, notes = converted(stored[..., colours], space)
    profile = spec.getattribute("ICCProfile:profile_description")
    if profile:
        notes.append(f"its colour profile {profile!r} is not used: values count as linear Rec.709")
    if "A" in names:
        notes += transparency(stored[..., names.index("A")], pixels)
    if several:
        notes.append("the first of its pictures is read")
    return pixels, notes


def _words(reason: str) -> str:
    return " ".join(reason.split())[:200]
