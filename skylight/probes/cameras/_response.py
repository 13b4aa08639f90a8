"""Camera response curves: applied, and recovered from exposures."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8, UInt16
from torch import Tensor

from skylight.errors import InputError
from skylight.imaging._colour import decode_values, encode_values
from skylight.io._bounded import read_number, read_object, require_keys, write_json

Kind = Literal["srgb", "gamma", "curve"]
Codes = UInt8[np.ndarray, "h w 3"] | UInt16[np.ndarray, "h w 3"]
SATURATED = 250 / 255  # noise and sharpening keep clipped pixels a few codes below the top
LEVELS = 256
_KIND = "camera response"
_CHANNELS = ("red", "green", "blue")
_PLACES_A_LEVEL, _BRIGHTNESS_LEVELS = 8, 32
_SPAN_MIN = 100  # codes that the pictures must cover
_RATIO_MIN = 1.2  # between the longest and the shortest exposure


@dataclass(frozen=True, kw_only=True)
class Response:
    """How a camera's codes encode light.

    ``kind`` is "srgb"; "gamma", light = (code / largest)^gamma; or "curve": ``curve[c, i]`` is
    channel c's light at code i / (n - 1) of the largest, with straight lines between.
    """

    kind: Kind = "srgb"
    gamma: float | None = None
    curve: Float[np.ndarray, "3 n"] | None = None

    def __post_init__(self) -> None:
        if self.kind not in ("srgb", "gamma", "curve"):
            raise InputError(f"unknown response {self.kind!r}: choose srgb, gamma or curve")
        if (self.kind == "gamma") != (self.gamma is not None) or (self.kind == "curve") != (
            self.curve is not None
        ):
            raise InputError(
                'a response of the kind "gamma" needs gamma alone, a "curve" the curve alone'
            )
        if self.gamma is not None and not 0 < self.gamma < 10:
            raise InputError(f"gamma must be above 0 and below 10, got {self.gamma:g}")
        if self.curve is not None:
            if self.curve.ndim != 2 or len(self.curve) != 3 or self.curve.shape[1] < LEVELS:
                raise InputError(
                    f"a response curve has 3 rows of {LEVELS} or more, got {self.curve.shape}"
                )
            rises = (np.diff(self.curve, axis=1) >= 0).all()
            if not (np.isfinite(self.curve).all() and rises and self.curve.min() >= 0):
                raise InputError("a response curve must be finite, 0 or more, and never fall")
            if not (self.curve[:, -1] > 0).all():
                raise InputError("a response curve must rise above 0")

    def linearise(self, image: Codes) -> Float[Tensor, "h w 3"]:
        """Linear light of 8-bit or 16-bit codes, float32; 1 is the largest code's of "srgb"."""
        if image.dtype == np.uint8:
            import cv2

            return torch.from_numpy(np.asarray(cv2.LUT(image, self._table)))
        if image.dtype != np.uint16:
            raise InputError(f"codes must be uint8 or uint16, got {image.dtype}")
        return torch.from_numpy(self._light(image / 65535.0))

    @cached_property
    def _table(self) -> Float[np.ndarray, "256 1 3"]:
        """Light of the 8-bit codes."""
        codes = np.arange(LEVELS)[:, None, None]
        return self._light(np.repeat(codes / 255.0, 3, axis=2))

    def _light(self, share: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
        if self.curve is None:
            decode = "srgb" if self.gamma is None else self.gamma
            return decode_values(torch.from_numpy(share.astype(np.float32)), decode).numpy()
        at = np.linspace(0, 1, self.curve.shape[1])
        light = [np.interp(share[..., c], at, self.curve[c]) for c in range(3)]
        return np.stack(light, -1).astype(np.float32)

    def encode(self, light: Float[Tensor, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
        """8-bit codes of linear light, the inverse of :meth:`linearise`; what is too bright clips.

        Where a curve is flat, light has several codes, and the largest is taken.
        """
        if self.curve is None:
            decode = "srgb" if self.gamma is None else self.gamma
            share = encode_values(light.clamp(0, 1), decode).numpy()
        else:
            at = np.linspace(0, 1, self.curve.shape[1])
            share = np.stack([np.interp(light[..., c], self.curve[c], at) for c in range(3)], -1)
        return np.clip(np.rint(share * 255), 0, 255).astype(np.uint8)


def saturated(image: Codes) -> Bool[np.ndarray, "h w"]:
    """Where a channel is at 250/255 of the largest code or above, so more light may have fallen."""
    least = math.ceil(SATURATED * np.iinfo(image.dtype).max - 1e-6)
    return np.asarray(image.max(-1) >= least)


def recover_response(
    pictures: Sequence[UInt8[np.ndarray, "h w 3"]],
    exposure_times: Sequence[float],
    *,
    smoothness: float = 50.0,
) -> Response:
    """The curve of a camera from pictures of one still scene, exposed for different times.

    With g = ln f^-1 and codes z_ij of place i in picture j, the least squares of Debevec & Malik
    1997 ("Recovering high dynamic range radiance maps from photographs", Eq. 3)::

        sum_ij [w(z_ij) (g(z_ij) - ln E_i - ln t_j)]^2 + smoothness sum_z [w(z) g''(z)]^2

    with g(128) = 0 and the hat weight w(z) = min(z, 255 - z) + 1, 0 for the lowest and highest
    codes, then made monotone by isotonic regression. The channels' relation to each other cannot
    be seen in exposures: equal codes of 128 are taken for grey. The largest value is 1.

    Parameters
    ----------
    pictures
        8 bit, one size, from a camera that did not move, with everything but the time fixed.
    exposure_times
        Of each picture, in seconds or relative.

    Raises
    ------
    InputError
        Fewer than two pictures or exposures too alike, sizes that differ, pictures that do not
        get brighter with longer times, or too few codes in them.
    """
    times = np.asarray(exposure_times, dtype=np.float64)
    _check(pictures, times)
    stack = np.stack(pictures)[np.argsort(times)]
    times = np.sort(times)
    means = stack.astype(np.float64).mean((1, 2, 3))
    if (np.diff(means) < -0.5).any() or means[-1] - means[0] < 2:
        raise InputError(
            "the pictures do not get brighter with longer exposures: see that each time belongs to "
            "its picture, and that aperture, ISO and white balance were fixed"
        )
    rows, columns = _smooth_places(stack)
    logs = []
    for channel in range(3):
        codes = stack[:, rows, columns, channel].astype(int)
        # a place that is dark or clipped throughout says nothing
        codes = codes[:, ((codes > 2) & (codes < 253)).sum(0) >= 2]
        if codes.size == 0 or np.ptp(codes) < _SPAN_MIN:
            raise InputError(
                f"the pictures show too few of the {LEVELS} codes of {_CHANNELS[channel]}: take a "
                "scene with dark and bright parts, and exposures from too dark to too bright"
            )
        logs.append(_log_curve(codes, np.log(times), smoothness))
    curve = np.exp(np.stack(logs))
    return Response(kind="curve", curve=curve / curve.max())


def describe_response(response: Response | None) -> dict[str, object]:
    """``kind`` and ``curve`` for notes; "linear" of light that needed no response."""
    curve = None if response is None else response.curve
    return {
        "kind": "linear" if response is None else response.kind,
        "curve": None if curve is None else curve.tolist(),
    }


def save_response(path: str | Path, response: Response) -> None:
    """Write the response as JSON."""
    content: dict[str, object] = {"kind": _KIND, "response": response.kind}
    if response.gamma is not None:
        content["gamma"] = response.gamma
    if response.curve is not None:
        content["curve"] = response.curve.tolist()
    write_json(path, content)


def load_response(path: str | Path) -> Response:
    """The response that :func:`save_response` wrote.

    Raises
    ------
    InputError
        The file is missing or no such file, or its values cannot be.
    """
    content = read_object(path, _KIND)
    kind = content.get("response")
    require_keys(path, content, ["response", *([kind] if kind in ("gamma", "curve") else [])])
    try:
        if kind == "gamma":
            return Response(kind="gamma", gamma=read_number(content, "gamma"))
        if kind == "curve":
            try:
                curve = np.array(content["curve"], dtype=np.float64)
            except (TypeError, ValueError) as error:
                raise InputError('"curve" must be three rows of numbers') from error
            if curve.ndim != 2:
                raise InputError('"curve" must be three rows of numbers')
            return Response(kind="curve", curve=curve)
        if kind != "srgb":
            raise InputError(f"unknown response {kind!r}: choose srgb, gamma or curve")
        return Response()
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _check(pictures: Sequence[np.ndarray], times: Float[np.ndarray, " p"]) -> None:
    if len(pictures) != len(times):
        raise InputError(f"{len(pictures)} pictures and {len(times)} exposure times: give one each")
    if len(pictures) < 2:
        raise InputError("a response needs 2 pictures or more, better 5, of different exposures")
    if not (np.isfinite(times).all() and (times > 0).all()):
        raise InputError("exposure times must be above 0")
    if times.max() / times.min() < _RATIO_MIN:
        raise InputError(
            f"the exposures differ by a factor of {times.max() / times.min():.2g} only: double the "
            "time from picture to picture"
        )
    for number, picture in enumerate(pictures):
        if picture.dtype != np.uint8 or picture.shape != pictures[0].shape:
            raise InputError(
                f"picture {number + 1} is {picture.dtype} of {picture.shape} and the first of "
                f"{pictures[0].shape}: give 8-bit pictures of one size"
            )


def _smooth_places(stack: UInt8[np.ndarray, "p h w 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of samples of all brightnesses, each where the local variance is least.

    There small camera motion, sharpening and noise matter least.
    """
    import cv2

    grey = stack.astype(np.float32).mean((0, 3))
    mean = cv2.blur(grey, (5, 5))
    variance = cv2.blur(grey**2, (5, 5)) - mean**2
    edges = np.quantile(mean, np.linspace(0, 1, _BRIGHTNESS_LEVELS + 1))
    chosen = []
    for low, high in pairwise(edges):
        inside = np.flatnonzero((mean.ravel() >= low) & (mean.ravel() <= high))
        calm = inside[np.argsort(variance.ravel()[inside], kind="stable")]
        chosen.append(calm[:_PLACES_A_LEVEL])
    places = np.unique(np.concatenate(chosen))
    return places // mean.shape[1], places % mean.shape[1]


def _log_curve(
    codes: np.ndarray, log_times: Float[np.ndarray, " p"], smoothness: float
) -> Float[np.ndarray, "256"]:
    """g at all codes, non-decreasing."""
    from scipy.optimize import isotonic_regression

    level = np.arange(LEVELS)
    weight = np.minimum(level, LEVELS - 1 - level) + 1.0
    # the lowest and highest codes stand for all light below and above
    weight[[0, 1, -2, -1]] = 0.0
    pictures, places = codes.shape
    flat = codes.ravel()
    w = weight[flat]
    equations = np.arange(flat.size)
    data = np.zeros((flat.size, LEVELS + places))
    data[equations, flat] = w
    data[equations, LEVELS + np.tile(np.arange(places), pictures)] = -w
    bend = np.zeros((LEVELS - 2, LEVELS + places))
    inner = level[1:-1]
    # with weight 0 the ends would be free; a straight continuation is the best guess there
    stiffness = math.sqrt(smoothness) * np.maximum(weight[1:-1], 1.0)
    for shift, factor in ((-1, 1.0), (0, -2.0), (1, 1.0)):
        bend[inner - 1, inner + shift] = factor * stiffness
    anchor = np.zeros((1, LEVELS + places))
    anchor[0, LEVELS // 2] = 1e3
    right = np.concatenate([w * np.repeat(log_times, places), np.zeros(LEVELS - 2 + 1)])
    solution, *_ = np.linalg.lstsq(np.concatenate([data, bend, anchor]), right, rcond=None)
    counts = np.bincount(flat, minlength=LEVELS) + 1.0
    curve = isotonic_regression(solution[:LEVELS], weights=counts).x
    return curve - curve[LEVELS // 2]
