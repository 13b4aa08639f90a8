"""The albedo of a kernel's material, from one photo of it beside a surface of known reflectance."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from skylight.cameras.response import Response, saturated
from skylight.errors import InputError
from skylight.io.json_files import read_object, require_keys, write_json

USUAL = 0.8  # of white filament, where nobody says or measures it
_KIND, _FORMAT = "kernel albedo", 1
_BLOCKS = 4  # along each side of a patch, to tell how even it is
_LEAST_SIDE_PX = 2 * _BLOCKS
_MOST_CLIPPED = 0.01
_LEAST_LIGHT = 1e-3
_PATCH_SHARE = 0.6  # of a chart's patch, along each side
_LEAST_GREYS = 4
# Linear Rec.709 under D65 of white 9.5, neutral 8, 6.5, 5, 3.5 and black 2 of the ColorChecker:
# the averages over 30 charts (Pascale, "The ColorChecker", BabelColor 2012, xyY under D50),
# adapted to D65 by Bradford's matrix.
GREYS = np.array(
    [
        [0.9182, 0.9146, 0.8740],
        [0.5811, 0.5911, 0.5851],
        [0.3544, 0.3611, 0.3596],
        [0.1871, 0.1924, 0.1920],
        [0.0867, 0.0900, 0.0910],
        [0.0318, 0.0320, 0.0327],
    ]
)
_FIRST_GREY = 18  # of 24 patches, row by row

Rectangle = tuple[int, int, int, int]


@dataclass(frozen=True, kw_only=True, eq=False)
class KernelAlbedo:
    """Linear Rec.709 ``rgb`` (3,), its standard ``error`` (3,), and the ``reference`` target."""

    rgb: Float[Tensor, "3"]
    error: Float[Tensor, "3"]
    reference: str

    def __post_init__(self) -> None:
        if not bool(((self.rgb > 0) & (self.rgb <= 1)).all()):
            told = ", ".join(f"{value:.3g}" for value in self.rgb)
            raise InputError(f"an albedo is above 0 and at most 1, not ({told})")
        if not bool((self.error.isfinite() & (self.error >= 0)).all()):
            raise InputError("an albedo's error must be finite and 0 or more")


def albedo_beside_card(
    photo: UInt8[np.ndarray, "h w 3"],
    response: Response,
    patch: Rectangle,
    card: Rectangle,
    card_albedo: float,
) -> KernelAlbedo:
    """From rectangles (x, y, width, height in px) of the material and of a grey card beside it.

    ``rho = rho_card s / s_card`` for Lambertian surfaces side by side. Errors are those of the
    means, by how much 4 x 4 blocks of each rectangle differ.
    """
    if not 0 < card_albedo <= 1:
        raise InputError(f"a card's albedo is above 0 and at most 1, got {card_albedo:g}")
    light, burnt = response.linearise(photo).numpy(), saturated(photo)
    here, here_error = _mean_of(light, burnt, patch, "patch")
    there, there_error = _mean_of(light, burnt, card, "card")
    if there.min() < _LEAST_LIGHT:
        raise InputError("the card is black in the photo: expose longer, or check its rectangle")
    rgb = card_albedo * here / there
    relative = np.hypot(here_error / np.maximum(here, 1e-9), there_error / there)
    return _compared(rgb, rgb * relative, "grey card")


def albedo_beside_chart(
    photo: UInt8[np.ndarray, "h w 3"], response: Response, patch: Rectangle
) -> KernelAlbedo:
    """From a ColorChecker in the photo and a rectangle (x, y, width, height) of the material.

    A straight line through the six greys, ``s = a + k rho`` in each colour, tells the light k and
    what stray light adds, and ``rho = (s - a) / k``. The error is that of a value read off a line
    with ordinary least squares.
    """
    light, burnt = response.linearise(photo).numpy(), saturated(photo)
    greys, fit = _grey_patches(photo, light, burnt)
    here, here_error = _mean_of(light, burnt, patch, "patch")
    known = GREYS[fit]
    if len(known) < _LEAST_GREYS:
        raise InputError(
            f"{len(GREYS) - len(known)} of the chart's 6 greys are over-exposed: expose shorter"
        )
    middle = known.mean(0)
    spread = ((known - middle) ** 2).sum(0)
    slope = ((known - middle) * greys[fit]).sum(0) / spread
    if slope.min() < _LEAST_LIGHT:
        raise InputError("the chart's greys do not differ as they should: see that it lies flat")
    start = greys[fit].mean(0) - slope * middle
    off = greys[fit] - start - slope * known
    variance = (off**2).sum(0) / (len(known) - 2)
    rgb = (here - start) / slope
    error = (
        np.sqrt(variance * (1 / len(known) + (rgb - middle) ** 2 / spread) + here_error**2) / slope
    )
    return _compared(rgb, error, "ColorChecker")


def save_albedo(path: str | Path, albedo: KernelAlbedo) -> None:
    """Write it as JSON."""
    write_json(
        path,
        {
            "kind": _KIND,
            "format": _FORMAT,
            "albedo": albedo.rgb.tolist(),
            "standard_error": albedo.error.tolist(),
            "told_by": albedo.reference,
        },
    )


def read_albedo(told: str | None) -> KernelAlbedo:
    """From a number, or the name of a file that :func:`save_albedo` wrote; 0.8 from None.

    Raises
    ------
    InputError
        It is neither, or no albedo.
    """
    if told is None:
        return _uniform(USUAL, "assumed")
    try:
        value = float(told)
    except ValueError:
        return _load(Path(told))
    return _uniform(value, "given")


def _uniform(value: float, reference: str) -> KernelAlbedo:
    rgb = torch.full((3,), value, dtype=torch.float64)
    return KernelAlbedo(rgb=rgb, error=torch.zeros_like(rgb), reference=reference)


def _compared(
    rgb: Float[np.ndarray, "3"], error: Float[np.ndarray, "3"], reference: str
) -> KernelAlbedo:
    try:
        return KernelAlbedo(
            rgb=torch.from_numpy(rgb), error=torch.from_numpy(error), reference=reference
        )
    except InputError as wrong:
        raise InputError(
            f"{wrong}: material and {reference} must lie side by side, in the same light and "
            "without gloss"
        ) from wrong


def _load(path: Path) -> KernelAlbedo:
    content = read_object(path, _KIND)
    require_keys(path, content, ["format", "albedo", "standard_error", "told_by"])
    if content["format"] != _FORMAT:
        raise InputError(f"{path}: of format {content['format']}, this program reads {_FORMAT}")
    try:
        rgb, error = (
            torch.from_numpy(np.array(content[name], dtype=np.float64).reshape(3))
            for name in ("albedo", "standard_error")
        )
        return KernelAlbedo(rgb=rgb, error=error, reference=str(content["told_by"]))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: an albedo is three numbers ({error})") from error


def _mean_of(
    light: Float[np.ndarray, "h w 3"],
    burnt: Bool[np.ndarray, "h w"],
    rectangle: Rectangle,
    name: str,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """(mean, its standard error) of a rectangle."""
    x, y, width, height = rectangle
    rows, columns = light.shape[:2]
    if x < 0 or y < 0 or x + width > columns or y + height > rows:
        raise InputError(
            f"{name} {x} {y} {width} {height} (x, y, width, height) leaves the photo, which is "
            f"{columns}x{rows}"
        )
    if min(width, height) < _LEAST_SIDE_PX:
        raise InputError(f"the {name} must be {_LEAST_SIDE_PX} pixels wide and high or more")
    there = np.s_[y : y + height, x : x + width]
    if burnt[there].mean() > _MOST_CLIPPED:
        raise InputError(f"the {name} is over-exposed: expose shorter")
    blocks = np.array(
        [
            block.mean((0, 1), dtype=np.float64)
            for band in np.array_split(light[there], _BLOCKS, axis=0)
            for block in np.array_split(band, _BLOCKS, axis=1)
        ]
    )
    return blocks.mean(0), blocks.std(0, ddof=1) / _BLOCKS


def _grey_patches(
    photo: UInt8[np.ndarray, "h w 3"],
    light: Float[np.ndarray, "h w 3"],
    burnt: Bool[np.ndarray, "h w"],
) -> tuple[Float[np.ndarray, "6 3"], Bool[np.ndarray, "6"]]:
    """(mean light of a ColorChecker's greys from white to black, which are not over-exposed)."""
    detector = cv2.mcc.CCheckerDetector.create()
    detector.setColorChartType(cv2.mcc.MCC24)
    if not detector.process(np.ascontiguousarray(photo[..., ::-1]), 1):
        raise InputError(
            "no ColorChecker in the photo: see that all its 24 patches are in view, sharp and "
            "large, or give --card and --card-albedo"
        )
    corners = np.array(detector.getBestColorChecker().getColorCharts()).reshape(-1, 4, 2)
    greys, fit = [], []
    for quad in corners[_FIRST_GREY:]:
        inner = quad.mean(0) + _PATCH_SHARE * (quad - quad.mean(0))
        mask = np.zeros(burnt.shape, np.uint8)
        cv2.fillConvexPoly(mask, np.rint(inner).astype(np.int32), 1)
        inside = mask.astype(bool)
        if not inside.any():
            raise InputError("part of the ColorChecker is out of the photo: take all of it")
        greys.append(light[inside].mean(0, dtype=np.float64))
        fit.append(burnt[inside].mean() <= _MOST_CLIPPED)
    return np.array(greys), np.array(fit)
