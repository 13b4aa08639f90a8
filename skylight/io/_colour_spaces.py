"""Colour spaces that files declare, converted to linear Rec.709 with a D65 white.

A space is told by chromaticities, by code points (CICP, ITU-T H.273), by a Color Interop Forum ID
("lin_ap1_scene"), or by its name; what ICC profiles say is for a colour management module.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

Primaries = Literal[
    "rec709", "p3-d65", "p3-dci", "rec2020", "ap0", "ap1", "adobe-rgb", "prophoto",
    "rec601-625", "rec601-525", "ebu3213", "rec470m", "film-c", "xyz-d65",
]  # fmt: skip
# a named curve, or the exponent of a power law
Transfer = Literal["linear", "srgb", "rec709", "pq", "hlg"] | float
Chromaticities = tuple[float, float, float, float, float, float, float, float]

_D65, _D50 = (0.3127, 0.3290), (0.3457, 0.3585)
_DCI, _ACES, _C = (0.314, 0.351), (0.32168, 0.33767), (0.310, 0.316)
# CIE xy of red, green, blue and white. Sources: BT.709-6; SMPTE EG 432-1 and RP 431-2; BT.2020-2;
# SMPTE ST 2065-1 (AP0) and S-2014-004 (AP1); Adobe RGB (1998) 4.3; ISO 22028-2 (ProPhoto); BT.601-7
# and H.273, table 2, for the rest.
CHROMATICITIES: dict[Primaries, Chromaticities] = {
    "rec709": (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, *_D65),
    "p3-d65": (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, *_D65),
    "p3-dci": (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, *_DCI),
    "rec2020": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *_D65),
    "ap0": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.0770, *_ACES),
    "ap1": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, *_ACES),
    "adobe-rgb": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *_D65),
    "prophoto": (0.734699, 0.265301, 0.159597, 0.840403, 0.036598, 0.000105, *_D50),
    "rec601-625": (0.64, 0.33, 0.29, 0.60, 0.15, 0.06, *_D65),
    "rec601-525": (0.63, 0.34, 0.31, 0.595, 0.155, 0.07, *_D65),
    "ebu3213": (0.63, 0.34, 0.295, 0.605, 0.155, 0.077, *_D65),
    "rec470m": (0.67, 0.33, 0.21, 0.71, 0.14, 0.08, *_C),
    "film-c": (0.681, 0.319, 0.243, 0.692, 0.145, 0.049, *_C),
}
TOLERANCE = 2e-3  # of chromaticities: files round them, and a matrix changes by less than a code

WHITE_CD_M2 = 203.0  # what PQ's 1 stands for here: HDR reference white, BT.2408-7, table 1
ADOBE_GAMMA = 563 / 256  # Adobe RGB (1998), 4.3.4.2
_HLG_WHITE = 0.75  # the HLG signal of the same white
_BLOCK_ROWS = 64

_WORDS: dict[Primaries, str] = {
    "rec709": "Rec.709", "p3-d65": "P3-D65", "p3-dci": "DCI-P3", "rec2020": "Rec.2020",
    "ap0": "ACES AP0", "ap1": "ACES AP1", "adobe-rgb": "Adobe RGB", "prophoto": "ProPhoto RGB",
    "rec601-625": "Rec.601 (625 lines)", "rec601-525": "Rec.601 (525 lines)",
    "ebu3213": "EBU 3213", "rec470m": "Rec.470 M", "film-c": "film (illuminant C)",
    "xyz-d65": "CIE XYZ",
}  # fmt: skip

# H.273, tables 2 and 3
_CICP_PRIMARIES: dict[int, Primaries] = {
    1: "rec709", 4: "rec470m", 5: "rec601-625", 6: "rec601-525", 7: "rec601-525", 8: "film-c",
    9: "rec2020", 10: "xyz-d65", 11: "p3-dci", 12: "p3-d65", 22: "ebu3213",
}  # fmt: skip
_CICP_TRANSFERS: dict[int, Transfer] = {
    1: "rec709", 4: 2.2, 5: 2.8, 6: "rec709", 8: "linear", 11: "rec709", 13: "srgb", 14: "rec709",
    15: "rec709", 16: "pq", 18: "hlg",
}  # fmt: skip

# the parts of a Color Interop Forum ID, and OpenImageIO's and OpenColorIO's names of their own kind
_ID = re.compile(
    r"(?:oiio:|ocio:)?(lin|srgbx|srgbe|srgb|itu709|g\d\d|pq|hlg)_(\w+?)(?:_(?:scene|display))?"
)
_ID_PRIMARIES: dict[str, Primaries] = {
    "rec709": "rec709", "srgb": "rec709", "p3d65": "p3-d65", "displayp3": "p3-d65",
    "p3dci": "p3-dci", "rec2020": "rec2020", "ap0": "ap0", "ap1": "ap1", "adobergb": "adobe-rgb",
    "prophoto": "prophoto", "xyzd65": "xyz-d65", "ciexyzd65": "xyz-d65", "rec601": "rec601-525",
    "rec601pal": "rec601-625",
}  # fmt: skip
_ALIASES = {
    "linear": "lin_rec709", "scene_linear": "lin_rec709", "linear rec.709 (srgb)": "lin_rec709",
    "srgb": "srgb_rec709", "srgb_texture": "srgb_rec709", "srgb_tx": "srgb_rec709",
    "rec709": "itu709_rec709", "acescg": "lin_ap1", "aces - acescg": "lin_ap1",
    "aces2065-1": "lin_ap0", "aces": "lin_ap0", "linear rec.2020": "lin_rec2020",
    "linear p3-d65": "lin_p3d65", "linear adobergb": "lin_adobergb", "adobergb": "g22_adobergb",
    "gammacorrected2.2": "g22_rec709", "gammacorrected1.8": "g18_rec709",
    "cie xyz-d65 - scene-referred": "lin_ciexyzd65",
}  # fmt: skip
_NOTHING_SAID = ("", "unknown", "data", "raw")


@dataclass(frozen=True, kw_only=True)
class ColourSpace:
    """RGB values: ``primaries`` by name, or as xy of red, green, blue and white; and their curve.

    Raises :class:`ValueError` for chromaticities that are no triangle, or no number.
    """

    primaries: Primaries | Chromaticities = "rec709"
    transfer: Transfer = "linear"

    def __post_init__(self) -> None:
        to_rec709(self.primaries)
        if isinstance(self.transfer, int | float):
            if not 0.1 <= self.transfer <= 10:
                raise ValueError(f"{self.transfer:g} is no exponent of a power law")
        elif self.transfer not in _CURVES:
            raise ValueError(f"{self.transfer!r} is no curve that is known here")

    @property
    def is_linear_rec709(self) -> bool:
        """Whether values need no conversion."""
        return self.transfer == "linear" and _named(self.primaries) == "rec709"

    def __str__(self) -> str:
        primaries = _named(self.primaries)
        told = "its own primaries" if primaries is None else _WORDS[primaries]
        curve = self.transfer
        if curve == "linear":
            return f"linear {told}"
        words = {"srgb": "sRGB's curve", "rec709": "Rec.709's curve", "pq": "PQ", "hlg": "HLG"}
        return f"{told}, {words[curve] if isinstance(curve, str) else f'gamma {curve:g}'}"

    def linear_rec709(
        self, values: Float[np.ndarray, "h w 3"], *, adapt: bool = True
    ) -> Float[np.ndarray, "h w 3"]:
        """Linear Rec.709 of such values, computed in float64; float32; ``adapt``: the white.

        Colours outside Rec.709 have negative components. Where nothing is to be converted, the
        values are returned as they are.
        """
        if self.is_linear_rec709:
            return np.asarray(values, np.float32)
        matrix = to_rec709(self.primaries, adapt)
        linear = np.empty(values.shape, np.float32)
        with np.errstate(invalid="ignore", over="ignore"):  # NaN and infinity stay or become NaN
            for start in range(0, len(values), _BLOCK_ROWS):
                rows = slice(start, start + _BLOCK_ROWS)
                linear[rows] = linear_light(values[rows], self.transfer) @ matrix.T
        return linear


def converted(
    values: Float[np.ndarray, "h w 3"], space: ColourSpace | None
) -> tuple[Float[np.ndarray, "h w 3"], list[str]]:
    """(linear Rec.709, what was done in words) of light in a space, None for linear Rec.709.

    Light is what was measured, so its XYZ is kept: a white other than D65 is not adapted. What
    becomes negative by the conversion, colours outside Rec.709, is cut at 0.
    """
    if space is None or space.is_linear_rec709:
        return values, []
    linear = space.linear_rec709(values, adapt=False)
    outside = (linear < 0) & (values >= 0).all(-1, keepdims=True)
    # what rounds to less than a hundredth of its pixel is no colour of its own
    seen = int((np.where(outside, linear, 0).min(-1) < -0.01 * linear.max(-1)).sum())
    linear[outside] = 0
    cut = f"; {seen} pixel(s) more saturated than Rec.709 are cut at 0" if seen else ""
    kept = "" if _has_d65(space.primaries) else "; their white, not D65, is kept as measured"
    return linear, [f"its colours, {space}, are converted to linear Rec.709{kept}{cut}"]


def colour_space_of_cicp(primaries: int, transfer: int) -> ColourSpace | None:
    """The space of two code points of ITU-T H.273; None where 2 leaves both open.

    One of the two that is left open (2) counts as Rec.709's or sRGB's.

    Raises
    ------
    ValueError
        A code point that is reserved, or whose curve is not known here.
    """
    if primaries == transfer == 2:
        return None
    first = "rec709" if primaries == 2 else _CICP_PRIMARIES.get(primaries)
    second = "srgb" if transfer == 2 else _CICP_TRANSFERS.get(transfer)
    if first is None:
        raise ValueError(f"its colour primaries (CICP {primaries}) are not known here")
    if second is None:
        raise ValueError(f"its transfer characteristics (CICP {transfer}) are not known here")
    return ColourSpace(primaries=first, transfer=second)


def colour_space_named(name: str) -> ColourSpace | None:
    """The space of a Color Interop Forum ID or another common name; None where it says nothing.

    Raises
    ------
    ValueError
        A name that is not known here.
    """
    plain = name.strip().lower()
    if plain in _NOTHING_SAID:
        return None
    parts = _ID.fullmatch(_ALIASES.get(plain, plain))
    primaries = _ID_PRIMARIES.get(parts[2]) if parts else None
    if parts is None or primaries is None:
        raise ValueError(
            f"its colour space {name[:80]!r} is not known here: export it as linear Rec.709"
        )
    curve = parts[1]
    curves: dict[str, Transfer] = {"lin": "linear", "itu709": "rec709", "pq": "pq", "hlg": "hlg"}
    if curve.startswith("srgb"):
        transfer: Transfer = "srgb"
    else:
        transfer = curves[curve] if curve in curves else int(curve[1:]) / 10
    if transfer == 2.2 and primaries == "adobe-rgb":
        transfer = ADOBE_GAMMA
    return ColourSpace(primaries=primaries, transfer=transfer)


@cache
def to_rec709(
    primaries: Primaries | Chromaticities, adapt: bool = True
) -> Float[np.ndarray, "3 3"]:
    """The matrix to linear Rec.709: ``M709^-1 A M``, float64; read-only.

    ``M`` takes RGB to XYZ and ``A`` is Bradford's adaptation of the white (ICC.1:2022, annex E),
    for pictures, whose white looks white; without ``adapt`` it is 1, for light, whose XYZ is kept.
    XYZ ("xyz-d65") is never adapted.

    Raises
    ------
    ValueError
        Chromaticities that are no triangle, or no number; a name that is not known.
    """
    inverse = np.linalg.inv(to_xyz("rec709"))
    named = _named(primaries)
    if named == "rec709":
        matrix = np.eye(3)
    elif named == "xyz-d65":
        matrix = inverse
    else:
        own = to_xyz(primaries)  # refuses what are no chromaticities
        white = _xy(primaries)[6:] if adapt else _D65
        matrix = inverse @ _bradford(white, _D65) @ own
    matrix.flags.writeable = False
    return matrix


def linear_light(encoded: Float[np.ndarray, "*s"], transfer: Transfer) -> Float[np.ndarray, "*s"]:
    """Relative linear light of encoded values, float64.

    ========  ======================================================================
    linear    the values
    srgb      IEC 61966-2-1, 5.2
    rec709    the inverse of the camera's curve, BT.709-6, item 1.2
    pq        SMPTE ST 2084, in units of 203 cd/m2 (HDR reference white, BT.2408)
    hlg       the inverse of the camera's curve, BT.2100-2, table 5, in units of the
              same white (75 % of the signal)
    number    v^number
    ========  ======================================================================

    Curves are continued as odd functions below 0, so that noise about black stays unbiased.
    """
    value = np.asarray(encoded, np.float64)
    if transfer == "linear":
        return value
    size = np.abs(value)
    if isinstance(transfer, int | float):
        return np.copysign(size**transfer, value)
    return np.copysign(_CURVES[transfer](size), value)


def _srgb(v: np.ndarray) -> np.ndarray:
    return np.where(v > 0.04045, ((v + 0.055) / 1.055) ** 2.4, v / 12.92)


def _rec709(v: np.ndarray) -> np.ndarray:
    return np.where(v < 0.081, v / 4.5, ((v + 0.099) / 1.099) ** (1 / 0.45))


def _pq(v: np.ndarray) -> np.ndarray:
    m1, m2 = 2610 / 16384, 2523 / 4096 * 128
    c1, c2, c3 = 3424 / 4096, 2413 / 4096 * 32, 2392 / 4096 * 32
    root = np.minimum(v, 1.0) ** (1 / m2)
    return 10_000 / WHITE_CD_M2 * (np.maximum(root - c1, 0) / (c2 - c3 * root)) ** (1 / m1)


def _hlg(v: np.ndarray) -> np.ndarray:
    a = 0.17883277
    b, c = 1 - 4 * a, 0.5 - a * math.log(4 * a)
    scene = np.where(v <= 0.5, v**2 / 3, (np.exp((v - c) / a) + b) / 12)
    return scene / ((math.exp((_HLG_WHITE - c) / a) + b) / 12)


_CURVES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "linear": np.asarray, "srgb": _srgb, "rec709": _rec709, "pq": _pq, "hlg": _hlg,
}  # fmt: skip


def _named(primaries: Primaries | Chromaticities) -> Primaries | None:
    """The name of primaries, where they have one."""
    if isinstance(primaries, str):
        if primaries not in get_args(Primaries):
            raise ValueError(f"{primaries!r} are no primaries that are known here")
        return primaries
    for name, known in CHROMATICITIES.items():
        if np.allclose(primaries, known, rtol=0, atol=TOLERANCE):
            return name
    return None


def to_xyz(primaries: Primaries | Chromaticities) -> Float[np.ndarray, "3 3"]:
    """RGB to XYZ, the white's luminance 1 (SMPTE RP 177), float64; raises as :func:`to_rec709`."""
    if primaries == "xyz-d65":
        return np.eye(3)
    corners = np.array(_xy(primaries), np.float64).reshape(4, 2)
    lengths = np.column_stack([corners, 1 - corners.sum(1)]).T  # x, y, z of each
    if not np.isfinite(lengths).all() or corners[3].min() <= 0:
        raise ValueError("its chromaticities are no colours")
    red_green_blue, white = lengths[:, :3], lengths[:, 3] / lengths[1, 3]
    if abs(np.linalg.det(red_green_blue)) < 1e-4:
        raise ValueError("its chromaticities are no triangle")
    return red_green_blue * np.linalg.solve(red_green_blue, white)


def _has_d65(primaries: Primaries | Chromaticities) -> bool:
    return primaries == "xyz-d65" or np.allclose(_xy(primaries)[6:], _D65, atol=TOLERANCE)


def _xy(primaries: Primaries | Chromaticities) -> Chromaticities:
    named = _named(primaries)
    if named is not None:
        return CHROMATICITIES[named]
    assert not isinstance(primaries, str)
    return primaries


def _bradford(source: tuple[float, ...], target: tuple[float, ...]) -> Float[np.ndarray, "3 3"]:
    """XYZ under one white to XYZ of the same look under another (Lam 1985; ICC.1:2022, E.3)."""
    if source == target:
        return np.eye(3)
    cones = np.array(
        [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
    )
    before, after = (cones @ [x / y, 1, (1 - x - y) / y] for x, y in (source, target))
    return np.linalg.inv(cones) @ np.diag(after / before) @ cones
