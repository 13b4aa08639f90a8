"""The albedo of the ground, by a ColorChecker that lies on it (thesis, B.2 and Fig. B.4)."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from skylight.errors import InputError
from skylight.probes.chart.chart import LEAST_LIGHT, MOST_CLIPPED, GreyLine, Rectangle, find_chart

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
    """What a lens leaves of light at each pixel, 1 where most: a photo of something even, smoothed.

    Raises
    ------
    InputError
        It is saturated, black, or not even.
    """
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
