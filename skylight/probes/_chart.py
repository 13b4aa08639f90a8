"""Albedo by a ColorChecker in the photo: of a patch beside it, or of the ground that it lies on.

The chart's five greys, whose albedos are known, give the line from albedo to light; ground in the
same light is read off it (thesis, B.2 and Fig. B.4).
"""

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8

from skylight.errors import InputError
from skylight.imaging._colour import tone_map
from skylight.io._hdr import SUFFIXES as HDR_SUFFIXES
from skylight.models._ground import USUAL_SPREAD, KnownGround
from skylight.probes.cameras._exposure_files import read_exposure
from skylight.probes.cameras._response import SATURATED, Response, load_response, saturated
from skylight.work._progress import Tell

MOST_CLIPPED = 0.01  # share of an area
LEAST_LIGHT = 1e-3
_PATCH_SHARE = 0.6  # of a chart's patch, along each side
_LEAST_GREYS = 4
# Linear Rec.709 under D65 of neutral 8, 6.5, 5, 3.5 and black 2 of the ColorChecker: the averages
# over 30 charts (Pascale, "The ColorChecker", BabelColor 2012, xyY under D50), adapted to D65 by
# Bradford's matrix. The colours of charts made since November 2014 are others: by these greys what
# they tell of albedos from 0.03 to 0.8 is up to 2.5 % off. White is left out: it is 4 % darker
# there, and with it a dark albedo would be 20 % off.
GREYS = np.array(
    [
        [0.5811, 0.5911, 0.5851],
        [0.3544, 0.3611, 0.3596],
        [0.1871, 0.1924, 0.1920],
        [0.0867, 0.0900, 0.0910],
        [0.0318, 0.0320, 0.0327],
    ]
)
Rectangle = tuple[int, int, int, int]  # x, y of the upper left corner, width, height; px
_FIRST_GREY = 19  # of 24 patches, row by row: white, before it, is not used


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Corners (24,4,2), (x, y), of a ColorChecker's patches, row by row from the brown one."""

    corners: Float[np.ndarray, "24 4 2"]

    def outline(self, wider: float) -> Float[np.ndarray, "n 2"]:
        """The convex hull of its patches, made wider about its middle."""
        points = self.corners.reshape(-1, 2)
        middle = points.mean(0)
        hull = cv2.convexHull((middle + wider * (points - middle)).astype(np.float32))
        return hull.reshape(-1, 2).astype(np.float64)

    def greys(
        self, light: Float[np.ndarray, "h w 3"], burnt: Bool[np.ndarray, "h w"]
    ) -> tuple[Float[np.ndarray, "5 3"], Bool[np.ndarray, "5"]]:
        """(mean light of the greys from neutral 8 to black, which are not over-exposed)."""
        greys, fit = [], []
        for quad in self.corners[_FIRST_GREY:]:
            inner = quad.mean(0) + _PATCH_SHARE * (quad - quad.mean(0))
            if inner.min() < 0 or (inner.max(0) > np.array(burnt.shape[::-1]) - 1).any():
                raise InputError("part of the ColorChecker is out of the photo: take all of it")
            mask = np.zeros(burnt.shape, np.uint8)
            cv2.fillConvexPoly(mask, np.rint(inner).astype(np.int32), 1)
            inside = mask.astype(bool)
            greys.append(light[inside].mean(0, dtype=np.float64))
            fit.append(burnt[inside].mean() <= MOST_CLIPPED)
        return np.array(greys), np.array(fit)


def find_chart(codes: UInt8[np.ndarray, "h w 3"], otherwise: str = "") -> Chart:
    """The ColorChecker of a photo in sRGB; ``otherwise``: what else could be done, in the message.

    Raises
    ------
    InputError
        There is none.
    """
    detector = cv2.mcc.CCheckerDetector.create()
    detector.setColorChartType(cv2.mcc.MCC24)
    if not detector.process(np.ascontiguousarray(codes[..., ::-1]), 1):
        raise InputError(
            "no ColorChecker in the photo: see that all its 24 patches are in view, sharp and "
            f"large{otherwise}"
        )
    corners = np.array(detector.getBestColorChecker().getColorCharts(), dtype=np.float64)
    return Chart(corners=corners.reshape(-1, 4, 2))


@dataclass(frozen=True, kw_only=True)
class GreyLine:
    """s = a + k rho in each colour: what light s the chart's greys show of their albedos rho.

    ``slope`` k is the light on the chart, ``start`` a what stray light adds; ``variance`` is that
    of s about the line, ``count`` greys with mean albedo ``middle`` and ``spread``, the sum of
    squares about it.
    """

    slope: Float[np.ndarray, "3"]
    start: Float[np.ndarray, "3"]
    variance: Float[np.ndarray, "3"]
    count: int
    middle: Float[np.ndarray, "3"]
    spread: Float[np.ndarray, "3"]

    @staticmethod
    def through(greys: Float[np.ndarray, "5 3"], fit: Bool[np.ndarray, "5"]) -> "GreyLine":
        """By ordinary least squares through the greys that are not over-exposed."""
        known = GREYS[fit]
        if len(known) < _LEAST_GREYS:
            raise InputError(
                f"{len(GREYS) - len(known)} of the chart's 5 greys are over-exposed: expose shorter"
            )
        middle = known.mean(0)
        spread = ((known - middle) ** 2).sum(0)
        slope = ((known - middle) * greys[fit]).sum(0) / spread
        if slope.min() < LEAST_LIGHT:
            raise InputError(
                "the chart's greys do not differ as they should: see that it lies flat, or expose "
                "longer"
            )
        start = greys[fit].mean(0) - slope * middle
        off = greys[fit] - start - slope * known
        return GreyLine(
            slope=slope,
            start=start,
            variance=(off**2).sum(0) / (len(known) - 2),
            count=len(known),
            middle=middle,
            spread=spread,
        )

    def albedo(
        self, light: Float[np.ndarray, "3"], error: Float[np.ndarray, "3"]
    ) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """rho = (s - a) / k of light s with a standard ``error``, and rho's own."""
        rho = (light - self.start) / self.slope
        variance = self.variance * (1 / self.count + (rho - self.middle) ** 2 / self.spread)
        return rho, np.sqrt(variance + error**2) / self.slope


_BLOCKS = 12  # along each side of the photo, to tell how even the ground is
_CLEAR = 1.3  # times the chart, whose frame and shadow lie round its patches
_SMOOTH = 0.015  # of a flat field's longer side: the noise and texture of its surface
_LEAST_SHARE = 0.02  # of the photo
_DARKEST = 0.05  # of a flat field, against its brightest


@dataclass(frozen=True, kw_only=True)
class MeasuredGround:
    """Linear Rec.709 ``rgb``, its standard ``error``, and the ``share`` of the photo it is of."""

    rgb: Float[np.ndarray, "3"]
    error: Float[np.ndarray, "3"]
    share: float


def measure_ground(
    codes: UInt8[np.ndarray, "h w 3"],
    light: Float[np.ndarray, "h w 3"],
    burnt: Bool[np.ndarray, "h w"],
    *,
    region: Rectangle | None = None,
    gain: Float[np.ndarray, "a b 3"] | None = None,
) -> MeasuredGround:
    """The mean albedo of the ground by the chart's greys: rho = (s - a) / k of its mean light s.

    Chart and ground lie in one plane in the same light. The error is that of a value read off the
    greys' line, with that of the mean by how much blocks of the ground differ.

    Parameters
    ----------
    codes, light, burnt
        The photo in sRGB, where the chart is looked for; its linear light; where it is saturated.
    region
        The ground, (x, y, width, height) in px; by default all that is not chart.
    gain
        What the lens leaves of light, by :func:`flat_field`; by default it is even.

    Raises
    ------
    InputError
        No chart, one that is over-exposed, hardly any ground, or one that is saturated.
    """
    if gain is not None:
        if gain.shape != light.shape:
            raise InputError(
                f"the flat field has {gain.shape[1]}x{gain.shape[0]} pixels and the photo "
                f"{light.shape[1]}x{light.shape[0]}: take both alike"
            )
        light = light / gain
    chart = find_chart(codes)
    line = GreyLine.through(*chart.greys(light, burnt))
    ground = _region(region, burnt.shape)
    hull = np.rint(chart.outline(_CLEAR)).astype(np.int32)
    beside = np.ones(burnt.shape, np.uint8)
    cv2.fillConvexPoly(beside, hull, 0)
    ground &= beside > 0
    if ground.mean() < _LEAST_SHARE:
        raise InputError("hardly any ground beside the chart: step back, or give another --region")
    if burnt[ground].mean() > MOST_CLIPPED:
        raise InputError("the ground is over-exposed: expose shorter")
    mean, error = _mean(light, ground)
    rgb, error = line.albedo(mean, error)
    return MeasuredGround(rgb=rgb, error=error, share=float(ground.mean()))


def flat_field(
    light: Float[np.ndarray, "h w 3"], burnt: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w 3"]:
    """What a lens leaves of light at each pixel, 1 where most: a photo of something even."""
    if burnt.mean() > MOST_CLIPPED:
        raise InputError("the flat field is over-exposed: expose shorter")
    width = _SMOOTH * max(burnt.shape)
    smooth = cv2.GaussianBlur(light, (0, 0), width, borderType=cv2.BORDER_REPLICATE)
    most = smooth.max((0, 1))
    if most.min() < LEAST_LIGHT:
        raise InputError("the flat field is black: expose longer")
    gain = smooth / most
    if gain.min() < _DARKEST:
        raise InputError(
            "the flat field is not even: fill the picture with an overcast sky or a white wall"
        )
    return gain


def _region(region: Rectangle | None, shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    rows, columns = shape
    if region is None:
        return np.ones((rows, columns), bool)
    x, y, width, height = region
    if x < 0 or y < 0 or min(width, height) < 1 or x + width > columns or y + height > rows:
        raise InputError(
            f"the region {x} {y} {width} {height} (x, y, width, height) leaves the photo, which "
            f"is {columns}x{rows}"
        )
    inside = np.zeros((rows, columns), bool)
    inside[y : y + height, x : x + width] = True
    return inside


def _mean(
    light: Float[np.ndarray, "h w 3"], ground: Bool[np.ndarray, "h w"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """(mean, its standard error by the blocks that show mostly ground)."""
    means = []
    for lit, kept in zip(
        np.array_split(light, _BLOCKS), np.array_split(ground, _BLOCKS), strict=True
    ):
        for block, here in zip(
            np.array_split(lit, _BLOCKS, 1), np.array_split(kept, _BLOCKS, 1), strict=True
        ):
            if here.mean() > 0.5:
                means.append(block[here].mean(0, dtype=np.float64))
    if len(means) < 2:
        raise InputError("hardly any ground beside the chart: step back, or give another --region")
    error = np.std(means, 0, ddof=1) / np.sqrt(len(means))
    return light[ground].mean(0, dtype=np.float64), error


_UNSURE = 0.1  # relative error of an albedo


def ground_albedo(
    photo: Path,
    out: Path,
    *,
    flat: Path | None = None,
    region: Rectangle | None = None,
    response: Path | None = None,
    tell: Tell = print,
    warn: Tell = print,
) -> KnownGround:
    """Write ``out`` (.json): the ground's albedo by the ColorChecker that lies on it.

    ``flat`` is a photo of something even, by which vignetting is undone. The spread is what one
    place tells of the ground round it, a tenth, and the error.
    """
    if out.suffix.lower() != ".json":
        raise InputError(f"{out}: an albedo is written as .json; choose another name")
    curve = Response() if response is None else load_response(response)
    codes, light, burnt = _read(photo, curve)
    gain = None
    if flat is not None:
        _, even, over = _read(flat, curve)
        gain = flat_field(even, over)
    found = measure_ground(codes, light, burnt, region=region, gain=gain)
    error = float((found.error / np.maximum(found.rgb, 1e-6)).max())
    red, green, blue = found.rgb.tolist()
    try:
        ground = KnownGround(
            albedo=(red, green, blue), spread=min(2.0, math.hypot(USUAL_SPREAD, error))
        )
    except InputError as wrong:
        raise InputError(
            f"{photo}: {wrong}; chart and ground must lie flat in the same light, without specular "
            "reflection"
        ) from wrong
    ground.save(out, _facts(found, photo, flat))
    if error > _UNSURE:
        warn(
            f"the albedo is known to {error:.0%} only: see that chart and ground are lit alike, "
            "and check the response"
        )
    told = ", ".join(f"{v:.3f} +- {e:.3f}" for v, e in zip(found.rgb, found.error, strict=True))
    tell(
        f"{out}: albedo {told} (red, green, blue) of {found.share:.0%} of the photo; "
        f"--ground-albedo {ground.option()}"
    )
    return ground


def _facts(found: MeasuredGround, photo: Path, flat: Path | None) -> dict[str, object]:
    return {
        "standard_error": found.error.tolist(),
        "share_of_photo": found.share,
        "photo": str(photo),
        "flat_field": None if flat is None else str(flat),
    }


def _read(path: Path, response: Response) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(8-bit sRGB codes, linear light, where it is saturated) of a picture or RAW file."""
    image = read_exposure(path, response)
    if image.dtype == np.uint8:
        return image, response.linearise(image).numpy(), saturated(image)
    burnt = image.max(-1) >= (np.inf if path.suffix.lower() in HDR_SUFFIXES else SATURATED)
    return tone_map(torch.from_numpy(image)), image, burnt
