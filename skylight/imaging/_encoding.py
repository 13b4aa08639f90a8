"""How a picture's codes encode light, whatever its file says it with and however deep they are.

A colour profile (ICC.1:2022), code points (CICP, ITU-T H.273, in PNG, AVIF and HEIC), PNG's gAMA
and cHRM, what DCF cameras write for Adobe RGB, TIFF's and EXIF's own tags, or a bitmap's header.
Of several the first in this order counts, but for a PNG's cICP, which precedes its profile (PNG,
third edition, 4.3). What nothing is said of is sRGB.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO

import numpy as np
import torch
from jaxtyping import Float, UInt8
from PIL import ExifTags, Image, ImageCms

from skylight.imaging._colour import linear_to_srgb
from skylight.imaging._exif import exif_text
from skylight.io._colour_spaces import (
    ADOBE_GAMMA,
    CHROMATICITIES,
    Chromaticities,
    ColourSpace,
    colour_space_of_cicp,
    linear_light,
    to_rec709,
)

SRGB_GAMMA = 45455  # the gAMA that stands for sRGB's curve where no sRGB chunk does (PNG, 11.3.2.5)
_BAD_PROFILE = "its colour profile cannot be read; save as sRGB"
_BRIGHTEST = 1e4  # times white: PQ's largest code is 49
_SAME = 3  # codes of 255: an encoding that changes a colour by no more is sRGB
_PCS_WHITE = np.array([0.9642, 1.0, 0.8249])  # ICC.1:2022, 7.2.16
_ENOUGH = 2**20  # bytes of what is looked through for a declaration


@dataclass(frozen=True, kw_only=True)
class Encoding:
    """``linear Rec.709 = to_rec709 @ curve(values)``, values from 0 to 1 for integer codes."""

    curve: Callable[[Float[np.ndarray, "*s 3"]], Float[np.ndarray, "*s 3"]]
    to_rec709: Float[np.ndarray, "3 3"]

    @classmethod
    def of(cls, space: ColourSpace) -> "Encoding":
        """That of a colour space."""
        return cls(
            curve=lambda values: linear_light(values, space.transfer),
            to_rec709=to_rec709(space.primaries),
        )

    def linear(self, values: Float[np.ndarray, "*s 3"]) -> Float[np.ndarray, "*s 3"]:
        """Linear Rec.709, with negative components for colours outside."""
        return self.curve(values) @ self.to_rec709.T

    @property
    def is_srgb(self) -> bool:
        """Whether it is sRGB: shown by what it does to a lattice of colours, not by its name.

        ValueError for what makes no light of colours.
        """
        steps = np.linspace(0, 1, 9)
        lattice = np.stack(np.meshgrid(steps, steps, steps), -1).reshape(-1, 3)
        with np.errstate(all="ignore"):
            linear = self.linear(lattice)
        if not (np.abs(linear) < _BRIGHTEST).all():  # false for NaN too
            raise ValueError(_BAD_PROFILE)
        change = 255 * (linear_to_srgb(torch.from_numpy(linear).clamp(0, 1)).numpy() - lattice)
        return bool(np.abs(change).max() <= _SAME)


@dataclass(frozen=True)
class ProfileTables:
    """A colour profile that tells colours by tables, applied to 8 bits by LittleCMS."""

    profile: bytes

    def to_srgb(self, codes: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
        """ValueError for a profile that cannot be applied."""
        try:
            transform = ImageCms.buildTransform(
                BytesIO(self.profile), ImageCms.createProfile("sRGB"), "RGB", "RGB"
            )
            return np.array(ImageCms.applyTransform(Image.fromarray(codes), transform))
        except (ImageCms.PyCMSError, OSError) as error:
            raise ValueError(_BAD_PROFILE) from error


def encoding_of(
    profile: bytes | None, otherwise: Encoding | ColourSpace | None
) -> Encoding | ProfileTables | None:
    """What an ICC profile, or else the file, says; None where that is sRGB, or nothing.

    Raises
    ------
    ValueError
        A profile that cannot be read, or of other colours than grey and RGB.
    """
    found = _of_profile(profile) if profile else otherwise
    if isinstance(found, ColourSpace):
        found = Encoding.of(found)
    return None if isinstance(found, Encoding) and found.is_srgb else found


def _of_profile(profile: bytes) -> Encoding | ProfileTables:
    """Its tables where a profile has them, else curves and a matrix (ICC.1:2022, 8.10 and F)."""
    # bytes 16 to 19 of a profile name its colour space, 20 to 23 that of its results (7.2)
    kind, results = profile[16:20], profile[20:24]
    if profile[36:40] != b"acsp":
        raise ValueError(_BAD_PROFILE)
    if kind not in (b"RGB ", b"GRAY"):
        name = kind.decode("ascii", "replace").strip()
        raise ValueError(f"its colour profile is for {name} colours; save it as RGB (sRGB)")
    try:
        tags = _tags(profile)
        if b"cicp" in tags and (space := colour_space_of_cicp(*tags[b"cicp"][8:10])) is not None:
            return Encoding.of(space)
        if kind == b"GRAY" and b"kTRC" in tags:
            tone = _tone_curve(tags[b"kTRC"])
            curve = (lambda grey: _of_lightness(tone(grey))) if results == b"Lab " else tone
            curves, matrix = [curve] * 3, np.eye(3)
        elif b"A2B0" not in tags and {b"rXYZ", b"gXYZ", b"bXYZ", b"rTRC"} <= tags.keys():
            curves = [_tone_curve(tags[name]) for name in (b"rTRC", b"gTRC", b"bTRC")]
            colorants = [_xyz(tags[name]) for name in (b"rXYZ", b"gXYZ", b"bXYZ")]
            matrix = _from_pcs() @ np.column_stack(colorants)
        else:
            return ProfileTables(profile)
    except (struct.error, IndexError, KeyError) as error:
        raise ValueError(_BAD_PROFILE) from error
    red, green, blue = curves
    return Encoding(
        curve=lambda rgb: np.stack([red(rgb[..., 0]), green(rgb[..., 1]), blue(rgb[..., 2])], -1),
        to_rec709=matrix,
    )


def _tags(profile: bytes) -> dict[bytes, bytes]:
    (count,) = struct.unpack_from(">I", profile, 128)
    table = [struct.unpack_from(">4sII", profile, 132 + 12 * i) for i in range(min(count, 200))]
    return {name: profile[at : at + size] for name, at, size in table}


def _xyz(tag: bytes) -> Float[np.ndarray, "3"]:
    return np.array(struct.unpack_from(">3i", tag, 8)) / 65536


def _from_pcs() -> Float[np.ndarray, "3 3"]:
    """Profiles' XYZ, adapted to D50, to linear Rec.709.

    The axes of XYZ over the white's are an RGB of their own, whose primaries are (1, 0), (0, 1)
    and (0, 0).
    """
    x, y, z = _PCS_WHITE
    axes = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, x / (x + y + z), y / (x + y + z))
    return to_rec709(axes) / _PCS_WHITE


def _of_lightness(share: np.ndarray) -> np.ndarray:
    """Light of L* / 100, which grey profiles over Lab tell (CIE 15:2018, 8.2.1)."""
    return np.where(share > 0.08, ((share + 0.16) / 1.16) ** 3, share * 2700 / 24389)


def _tone_curve(tag: bytes) -> Callable[[np.ndarray], np.ndarray]:
    """A ``curv`` (ICC.1:2022, 10.6) or ``para`` (10.18, which writes X >= d for the power)."""
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        if count == 0:
            return lambda x: x
        if len(tag) < 12 + 2 * count:
            raise IndexError("cut short")
        entries = np.frombuffer(tag, ">u2", count, 12).astype(np.float64)
        if count == 1:
            return lambda x: np.maximum(x, 0) ** (entries[0] / 256)
        steps = np.linspace(0, 1, count)
        return lambda x: np.interp(x, steps, entries / 65535)
    if tag[:4] != b"para":
        raise KeyError(tag[:4])
    (kind,) = struct.unpack_from(">H", tag, 8)
    size = (1, 3, 4, 5, 7)[kind]
    told = [value / 65536 for value in struct.unpack_from(f">{size}i", tag, 12)]
    g, a, b, c, d, e, f = (told + [1.0, 0.0, 0.0, 0.0, 0.0, 0.0][size - 1 :])[:7]
    if kind in (1, 2):  # below -b / a there is c alone
        c, d, e, f = 0.0, -b / a if a else 0.0, c, c
    return lambda x: np.where(x >= d, np.maximum(a * x + b, 0) ** g + e, c * x + f)


# ---- what each kind of file says besides


def png_space(file: BinaryIO) -> tuple[ColourSpace | None, bool]:
    """(what the chunks before a PNG's pixels say, whether that precedes a colour profile).

    cICP comes first, then iCCP, sRGB, and gAMA and cHRM (PNG, third edition, 4.3).

    Raises
    ------
    ValueError
        Code points that are not known, or codes of narrow range.
    """
    chunks = dict(_png_chunks(file))
    if len(cicp := chunks.get(b"cICP", b"")) == 4:
        if cicp[2:] != b"\0\1":
            raise ValueError("its codes (cICP) are no RGB of full range; export it as such")
        if (space := colour_space_of_cicp(cicp[0], cicp[1])) is not None:
            return space, True
    if b"sRGB" in chunks:
        return ColourSpace(transfer="srgb"), False
    gamma, corners = chunks.get(b"gAMA", b""), chunks.get(b"cHRM", b"")
    stored = int.from_bytes(gamma, "big") if len(gamma) == 4 else 0
    xy: list[float] = []
    if len(corners) == 32:  # white first
        white_x, white_y, *rest = (value / 1e5 for value in struct.unpack(">8I", corners))
        xy = [*rest, white_x, white_y]
    return _own_space(xy, 1e5 / stored if stored and stored != SRGB_GAMMA else None), False


def _png_chunks(file: BinaryIO) -> Iterator[tuple[bytes, bytes]]:
    file.seek(8)
    while len(head := file.read(8)) == 8 and head[4:] != b"IDAT":
        length = int.from_bytes(head[:4], "big")
        if head[4:] in (b"cICP", b"sRGB", b"gAMA", b"cHRM"):
            yield head[4:], file.read(min(length, 32))
            length -= min(length, 32)
        file.seek(length + 4, 1)


def exif_space(exif: Image.Exif) -> ColourSpace | None:
    """What the tags of a camera or a TIFF file say.

    Cameras of the DCF standard (CIPA DC-009-2010, 3.2.2) write Adobe RGB as the interoperability
    index R03 and an uncalibrated ColorSpace (65535), others as ColorSpace 2, which EXIF does not
    list. Else WhitePoint and PrimaryChromaticities count, and EXIF's Gamma, where they are colours.
    """
    tags = exif.get_ifd(ExifTags.IFD.Exif)
    space = tags.get(ExifTags.Base.ColorSpace)
    try:
        index = exif_text(exif.get_ifd(ExifTags.IFD.Interop).get(1))
    except KeyError:  # Pillow before 13, where a file has none
        index = ""
    if space == 1:
        return None
    if space == 2 or index == "R03":
        return ColourSpace(primaries="adobe-rgb", transfer=ADOBE_GAMMA)
    if index == "R98":
        return None
    white = _floats(exif.get(ExifTags.Base.WhitePoint))
    corners = _floats(exif.get(ExifTags.Base.PrimaryChromaticities))
    xy = [*corners, *white] if (len(corners), len(white)) == (6, 2) else []
    gamma = _floats(tags.get(ExifTags.Base.Gamma))
    return _own_space(xy, gamma[0] if gamma else None)


def transfer_tables(exif: Image.Exif) -> Encoding | None:
    """TIFF's TransferFunction (6.0, section 20): for each code light from 0 to 65535."""
    entries = _floats(exif.get(ExifTags.Base.TransferFunction))
    count = len(entries) // 3 if len(entries) % 3 == 0 else len(entries)
    if count not in (2**8, 2**16) or max(entries) <= 0:
        return None
    tables = np.broadcast_to(np.array(entries).reshape(-1, count) / 65535, (3, count))
    steps, space = np.linspace(0, 1, count), exif_space(exif)
    return Encoding(
        curve=lambda rgb: np.stack(
            [np.interp(rgb[..., k], steps, tables[k]) for k in range(3)], -1
        ),
        to_rec709=np.eye(3) if space is None else to_rec709(space.primaries),
    )


def nclx_space(file: BinaryIO) -> ColourSpace | None:
    """The code points of an AVIF or HEIC file, its first ``colr`` of that kind (ISO/IEC 23008-12).

    ValueError for those that are not known.
    """
    file.seek(0)
    content = file.read(_ENOUGH)
    at = content.find(b"colrnclx")
    if at < 0 or len(content) < at + 12:
        return None
    return colour_space_of_cicp(*struct.unpack_from(">HH", content, at + 8))


def bitmap_space(file: BinaryIO) -> tuple[bytes | None, ColourSpace | None]:
    """(profile, colour space) of a bitmap's header of version 4 or 5 (BITMAPV5HEADER)."""
    file.seek(14)
    header = file.read(124)
    size = int.from_bytes(header[:4], "little")
    if size < 108 or len(header) < size:
        return None, None
    kind = header[56:60][::-1]
    if kind == b"MBED" and size >= 124:
        at, length = struct.unpack_from("<II", header, 112)
        file.seek(14 + at)
        return file.read(min(length, _ENOUGH)), None
    if kind != bytes(4):  # sRGB, or Windows' own, which is the same
        return None, None
    ends = np.array(struct.unpack_from("<9i", header, 60)).reshape(3, 3) / 2**30
    gammas = np.array(struct.unpack_from("<3I", header, 96)) / 2**16
    sums = ends.sum(1)
    if not (sums > 0).all() or not (gammas > 0).all() or np.ptp(gammas) > 1e-3:
        return None, None
    white = ends.sum(0)
    xy = [*(ends[:, :2] / sums[:, None]).ravel(), *(white[:2] / white.sum())]
    return None, _own_space([float(value) for value in xy], float(gammas[0]))


def _own_space(xy: list[float], gamma: float | None) -> ColourSpace | None:
    """A space told by xy of red, green, blue and white, by an exponent, or by both.

    None where neither is, or where they are no colours: such tags are passed over.
    """
    if not xy and gamma is None:
        return None
    try:
        corners: Chromaticities = tuple(xy) if xy else CHROMATICITIES["rec709"]  # type: ignore
        return ColourSpace(primaries=corners, transfer="srgb" if gamma is None else gamma)
    except ValueError:
        return None


def _floats(value: object) -> list[float]:
    """The numbers of a tag; none where one is no number."""
    try:
        return [float(part) for part in (value if isinstance(value, tuple) else (value,))]  # type: ignore
    except (TypeError, ValueError, ZeroDivisionError):
        return []
