"""Bracketed exposures merged into linear radiance, and light that saturates even the shortest."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from skimage.measure import label
from torch import Tensor

from skylight.errors import InputError
from skylight.probes._probe_map import ProbeMap
from skylight.probes.cameras._response import SATURATED, Response, recover_response, saturated
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import angles_from_direction

Choice = Literal["auto", "srgb", "recover"]
RATIO_MIN = 1.2  # between neighbouring exposures
# a known curve is kept unless the recovered one brings the exposures together clearly better
_BETTER, _BETTER_BY = 1.25, 0.005
_FADE = 0.1  # of the largest code below saturation, over which an exposure loses its weight
_ENOUGH_PX = 500_000
_SHARES = (0.1, 0.9)  # of the largest code: where two exposures are compared
# Of the sun's disc, 0.533 degrees across at the mean distance: pi (0.2665 pi / 180)^2.
SUN_SR = math.pi * math.radians(0.2665) ** 2
_COUNTS = 0.02  # share of a pixel from which it counts as a part of a region


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """One picture: 8-bit codes, or light that is linear already, and its time in seconds.

    Linear light saturates at 1, as raw developers write it.
    """

    name: str
    seconds: float
    image: UInt8[np.ndarray, "h w 3"] | Float[np.ndarray, "h w 3"]

    @property
    def is_linear(self) -> bool:
        return self.image.dtype != np.uint8


@dataclass(frozen=True, kw_only=True)
class Merged:
    """``radiance``, of which 1 saturates the longest exposure (in sRGB, or linear), and how known.

    ``clipped``
        where even the shortest exposure is saturated: more light may have fallen.
    ``response``
        the curve used; None for light that was linear already.
    ``disagreement``
        median of ``|ln(L_i / L_j)|`` between neighbouring exposures where both are well exposed;
        None where none are.
    ``notes``
        why this response.
    """

    radiance: Float[Tensor, "h w 3"]
    clipped: Bool[Tensor, "h w"]
    response: Response | None
    disagreement: float | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ExposureSeries:
    """The exposures of one view and what they were merged into.

    ``seconds`` is None for a file that was merged already, ``focal_px`` where no EXIF data tell.
    """

    files: tuple[Path, ...]
    seconds: tuple[float, ...] | None
    merged: Merged
    focal_px: float | None


def merge(exposures: Sequence[Exposure], response: Response | Choice = "auto") -> Merged:
    """Linear light from exposures that differ in time alone.

    Exposure j says L_j = f(z_j) / t_j, where f is the camera's response and z_j the code. Their
    mean is weighted by t_j z_j fade(max z_j): photon noise makes the variance of L_j fall as
    1 / t_j, quantisation counts most in low codes, and ``fade`` goes to 0 where the largest channel
    saturates. Places saturated in all get the shortest exposure's value, a lower bound. OpenCV's
    ``createMergeDebevec`` gives such places the geometric mean of all exposures, far too little,
    believes codes from 250 to 254, and takes 8 bits alone.

    Parameters
    ----------
    response
        A known curve; "srgb"; "recover" from the exposures; or "auto": recovered where there are
        three exposures or more with enough spread and sRGB makes them disagree clearly more, since
        exposures cannot show how the channels' curves relate.

    Raises
    ------
    InputError
        Fewer than two pictures, sizes or kinds that differ, times too alike, or no recovery.
    """
    check_bracket(exposures)
    ordered = sorted(exposures, key=lambda each: each.seconds)
    longest = ordered[-1].seconds
    times = [each.seconds / longest for each in ordered]
    thinned = [_thinned(each) for each in ordered]
    curve, notes = _response(thinned, times, response)
    total = np.zeros(ordered[0].image.shape, np.float32)
    weights = np.zeros(ordered[0].image.shape, np.float32)
    for each, time in zip(ordered, times, strict=True):
        share = _share(each)
        fade = np.clip((SATURATED - share.max(-1, keepdims=True)) / _FADE, 0, 1)
        # the share of one code: black pixels keep their weight
        weight = time * (share + 1 / 255) * fade
        total += weight * _light(each, curve) / time
        weights += weight
    unseen = weights == 0
    bound = _light(ordered[0], curve) / times[0]
    radiance = np.where(unseen, bound, total / np.where(unseen, 1, weights))
    return Merged(
        radiance=torch.from_numpy(radiance.astype(np.float32)),
        clipped=_clipped(ordered[0]),
        response=curve,
        disagreement=_disagreement(thinned, times, curve),
        notes=notes,
    )


def common_response(exposures: Sequence[Exposure], wanted: Choice) -> tuple[Response, str]:
    """The response that :func:`merge` would choose, "auto" or "recover", and why.

    Of 8-bit exposures of several views beside each other it is surer than of one.
    """
    check_bracket(exposures)
    ordered = sorted(exposures, key=lambda each: each.seconds)
    times = [each.seconds / ordered[-1].seconds for each in ordered]
    curve, notes = _response([_thinned(each) for each in ordered], times, wanted)
    return curve or Response(), "; ".join(notes)


def linearised(exposure: Exposure, response: Response | Choice = "auto") -> Merged:
    """Linear light of one exposure alone, of which whatever is saturated stays unknown."""
    if response == "recover":
        raise InputError(f"{exposure.name}: one exposure tells no response; give one, or sRGB")
    curve = None
    if not exposure.is_linear:
        curve = response if isinstance(response, Response) else Response()
    return Merged(
        radiance=torch.from_numpy(_light(exposure, curve)),
        clipped=_clipped(exposure),
        response=curve,
        disagreement=None,
    )


def check_bracket(exposures: Sequence[Exposure]) -> None:
    """Raise unless the pictures are a bracket."""
    if len(exposures) < 2:
        raise InputError(
            "one picture cannot show both lamps and shadows: give two exposures or more, or one "
            ".exr or .hdr that was merged already"
        )
    first = exposures[0]
    for each in exposures:
        if not (math.isfinite(each.seconds) and each.seconds > 0):
            raise InputError(f"{each.name}: an exposure time must be above 0, got {each.seconds}")
        if each.image.shape != first.image.shape:
            (height, width), (was_height, was_width) = each.image.shape[:2], first.image.shape[:2]
            raise InputError(
                f"{each.name}: {width}x{height} pixels, but {first.name} has "
                f"{was_width}x{was_height}; give pictures of one size"
            )
        if each.is_linear != first.is_linear:
            raise InputError(f"{each.name}: give either linear files or pictures, not both")
    ordered = sorted(exposures, key=lambda each: each.seconds)
    for short, long in pairwise(ordered):
        if long.seconds / short.seconds < RATIO_MIN:
            raise InputError(
                f"{short.name} and {long.name}: their exposures, {short.seconds:.3g} and "
                f"{long.seconds:.3g} s, are too alike; leave one out, or see to --times"
            )


def _clipped(exposure: Exposure) -> Bool[Tensor, "h w"]:
    """Where more light may have fallen."""
    image = exposure.image
    return torch.from_numpy(image.max(-1) >= SATURATED if exposure.is_linear else saturated(image))


def _response(
    ordered: Sequence[Exposure], times: Sequence[float], wanted: Response | Choice
) -> tuple[Response | None, tuple[str, ...]]:
    if ordered[0].is_linear:
        return None, ()
    if isinstance(wanted, Response):
        return wanted, ()
    known = Response()
    if wanted == "srgb":
        return known, ()
    pictures = [each.image for each in ordered]
    if wanted == "recover":
        return recover_response(pictures, times), ()
    if len(pictures) < 3:
        return known, ("sRGB is taken for the response: two exposures are too few to recover it",)
    try:
        found = recover_response(pictures, times)
    except InputError as error:
        return known, (f"sRGB is taken for the response; it could not be recovered: {error}",)
    by_known = _disagreement(ordered, times, known)
    by_found = _disagreement(ordered, times, found)
    if by_known is None or by_found is None:
        return known, ("sRGB is taken for the response: hardly a place shows in two exposures",)
    measured = (
        f"exposures disagree by {100 * by_known:.1f} % under sRGB, by {100 * by_found:.1f} % "
        "under the curve recovered from them"
    )
    if by_known > _BETTER * by_found + _BETTER_BY:
        return found, (f"the response was recovered: {measured}",)
    return known, (f"sRGB is taken for the response: {measured}",)


def _thinned(exposure: Exposure) -> Exposure:
    """Every second or n-th pixel of a large picture: enough to judge the response by."""
    step = math.ceil(math.sqrt(exposure.image[..., 0].size / _ENOUGH_PX))
    return replace(exposure, image=np.ascontiguousarray(exposure.image[::step, ::step]))


def _share(exposure: Exposure) -> Float[np.ndarray, "h w 3"]:
    """Codes, or linear light, as shares of the largest; float32."""
    image = exposure.image.astype(np.float32)
    return image if exposure.is_linear else image / np.float32(255)


def _light(exposure: Exposure, response: Response | None) -> Float[np.ndarray, "h w 3"]:
    """Linear light, float32, not yet divided by the time."""
    image = exposure.image
    return image.astype(np.float32) if response is None else response.linearise(image).numpy()


def _disagreement(
    ordered: Sequence[Exposure], times: Sequence[float], response: Response | None
) -> float | None:
    low, high = _SHARES
    apart = []
    for (one, time), (two, longer) in pairwise(zip(ordered, times, strict=True)):
        shares = _share(one), _share(two)
        both = np.logical_and.reduce([(share > low) & (share < high) for share in shares])
        lights = (_light(each, response)[both] for each in (one, two))
        short, long = (np.log(light.astype(np.float64)) for light in lights)
        apart.append(np.abs(short - long - math.log(time / longer)))
    values = np.concatenate(apart)
    return float(np.median(values)) if values.size >= 100 else None


@dataclass(frozen=True, kw_only=True)
class Clipping:
    """Light at which the shortest exposure is saturated.

    ``solid_angle_sr``
        of all of it.
    ``regions``
        how many there are.
    ``azimuth_deg``, ``zenith_deg``
        middle of the largest.
    ``light_share``
        of the light from all directions, the share that is counted there. It is counted at the
        level of saturation, so the true share is at least this.
    ``radiance_sr``
        sum of L dw over it, red, green and blue; the true one is at least this.
    """

    solid_angle_sr: float
    regions: int
    azimuth_deg: float
    zenith_deg: float
    light_share: float
    radiance_sr: tuple[float, float, float]

    def sentence(self) -> str:
        """For the user."""
        suns = self.solid_angle_sr / SUN_SR
        return (
            f"the shortest exposure is saturated over {self.solid_angle_sr:.2g} sr "
            f"({suns:.2g} times the sun's disc), mostly at azimuth {self.azimuth_deg:.0f}, zenith "
            f"{self.zenith_deg:.0f} degrees: that light counts with "
            f"{100 * self.light_share:.2g} % of all, and is more by an unknown factor; "
            "take shorter exposures"
        )


def find_clipping(probe: ProbeMap) -> Clipping | None:
    """What is clipped of a map; None where nothing is."""
    share = probe.clipped.numpy().astype(np.float64)
    if not (share > _COUNTS).any():
        return None
    labels, count = _regions(share > _COUNTS)
    environment = probe.environment
    grid = environment.grid
    weight = share.ravel() * grid.solid_angles.numpy() * (labels.ravel() > 0)
    sizes = np.bincount(labels.ravel(), weight)
    largest = int(sizes[1:].argmax()) + 1
    inside = torch.from_numpy(weight * (labels.ravel() == largest))
    azimuth, zenith = angles_from_direction(inside @ grid.directions)
    held = torch.from_numpy(weight) @ environment.flat.double()
    total = environment.integrate().double()
    return Clipping(
        solid_angle_sr=float(weight.sum()),
        regions=count,
        azimuth_deg=math.degrees(float(azimuth)),
        zenith_deg=math.degrees(float(zenith)),
        light_share=float(luminance(held) / luminance(total).clamp(min=1e-30)),
        radiance_sr=(float(held[0]), float(held[1]), float(held[2])),
    )


def _regions(mask: np.ndarray) -> tuple[np.ndarray, int]:
    """Labels from 1 of connected pixels, and their number.

    Pixels connect across the left and right edge as well, and all of the first and of the last row
    at a pole, where they meet.
    """
    labels = np.asarray(label(mask, connectivity=1))
    for row in (labels[0], labels[-1]):
        labels[np.isin(labels, row[row > 0])] = row.max()
    for row in labels:
        left, right = row[0], row[-1]
        if left and right:
            labels[labels == right] = left
    kinds, numbers = np.unique(labels, return_inverse=True)
    # 0, the background, may be missing
    return numbers.reshape(labels.shape) + (kinds[0] != 0), int((kinds != 0).sum())
