"""The light of a webcam or of a film as it plays."""

import math
import time
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray

from skylight.errors import InputError
from skylight.imaging._colour import Decode
from skylight.live._follow import FaceFollower
from skylight.live._prior import DEGREE
from skylight.live._solve import LOBE_RAD, LightSolver, lobes_on
from skylight.sphere._envmap import LUMINANCE, luminance
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._harmonics import evaluate

SETTLE_S = 0.3  # in which the light shown goes two thirds of the way to what is found
# By this part of its credible radius, and by so many degrees at least, a direction may differ
# before it is followed faster
_JUMP_SHARE, _LEAST_JUMP_RAD = 0.5, math.radians(4.0)
_MAP_ROWS = 16
_Y00 = 0.5 / math.sqrt(math.pi)


@dataclass(frozen=True, kw_only=True)
class Light:
    """Light in the camera's frame: right-handed, +Y up, the camera looks along -Z.

    Radiance is linear Rec.709, in units of the picture's white at its exposure of the moment, and
    supposes the skin of the mean person: on skin of half that albedo, it is half the truth.

    ``direction`` (3,) is a unit vector towards the main light, ``radius_90_rad`` its 90 % credible
    radius, of the cap about it that holds so much of the posterior (pi: nothing is known; in
    captured light fewer than 90 % of truths are within, see ``docs/live.md``), and ``irradiance``
    (3,) what a surface facing the main light receives of it. ``ambient`` (25,3) is all other light
    and ``harmonics`` (9,3) all light, as harmonics of radiance (:mod:`skylight.sphere`'s basis).
    ``seen`` is False where the face was not, and the light is the last one.
    """

    time_s: float
    direction: Float[ndarray, "3"]
    radius_90_rad: float
    irradiance: Float[ndarray, "3"]
    ambient: Float[ndarray, "25 3"]
    harmonics: Float[ndarray, "9 3"]
    seen: bool = True

    @property
    def mean_luminance(self) -> float:
        """Luminance of the mean radiance: lights of frames of other exposures are compared when
        each is divided by its own."""
        return float(self.harmonics[0] @ LUMINANCE) * _Y00

    @property
    def main_share(self) -> float:
        """Of what a surface facing the main light receives, the part that is the main light's."""
        main = float(luminance(torch.from_numpy(self.irradiance)))
        rest = math.pi * _Y00 * float(luminance(torch.from_numpy(self.ambient[0])))
        return main / max(main + max(rest, 0.0), 1e-12)

    @property
    def words(self) -> str:
        """How sure the direction is."""
        if not self.seen:
            return "no face is seen: this is the last light"
        degrees = math.degrees(self.radius_90_rad)
        if degrees > 60:
            return "even light, or a light that the face does not see: its direction is unknown"
        sure = "sure" if degrees <= 12 else "about right" if degrees <= 30 else "vague"
        return f"direction {sure}: 90 % credible radius {degrees:.0f} degrees"

    def facts(self) -> dict[str, object]:
        """Plain numbers, as files have them."""
        return {
            "seen": self.seen,
            "direction": _rounded(self.direction),
            "radius_90_deg": round(math.degrees(self.radius_90_rad), 2),
            "irradiance": _rounded(self.irradiance),
            "sh27": _rounded(self.harmonics.ravel()),
            "mean_luminance": round(self.mean_luminance, 5),
        }

    def radiance_map(self, rows: int = _MAP_ROWS) -> Float[ndarray, "h w 3"]:
        """A small lat-long map (``rows`` x twice as many): ambient light, 0 at least, and the main
        light as a lobe of 8 degrees."""
        grid = DirectionGrid.latlong(rows)
        radiance = evaluate(grid.directions, DEGREE).numpy() @ self.ambient
        # cells of 11 degrees are wider than the lobe
        width = max(LOBE_RAD, math.pi / rows / 2)
        lobe = lobes_on(grid, self.direction[None], width)
        radiance = radiance.clip(min=0) + lobe * self.irradiance
        return radiance.reshape(rows, 2 * rows, 3)


def _rounded(values: Float[ndarray, " n"]) -> list[float]:
    return np.round(values, 5).tolist()


@dataclass
class Timing:
    """Seconds of the processor that each of the last 1,000 frames took."""

    landmarks_s: deque[float] = field(default_factory=lambda: deque(maxlen=1000))
    light_s: deque[float] = field(default_factory=lambda: deque(maxlen=1000))

    def each_ms(self) -> tuple[float, float]:
        """Medians: of landmarks and pose, and of the light."""
        return (
            1000 * float(np.median(self.landmarks_s)),
            1000 * float(np.median(self.light_s)),
        )


class LiveLight:
    """The light of frames as they come, by the face that is largest in the first that has one.

    The first frame with a face takes half a second more than others: its head is fitted, and what
    its skin sees is traced. What is found is smoothed in time: over
    :data:`SETTLE_S`, and less the further the light has gone.

    Parameters
    ----------
    decode
        What the codes of frames are: "srgb", "linear", or the gamma of which they are a power.
    """

    def __init__(self, decode: Decode = "srgb") -> None:
        self.decode: Decode = decode
        self._follower = FaceFollower(decode)
        self._solver: LightSolver | None = None
        self._of: object = None
        self.light: Light | None = None
        self.timing = Timing()

    def update(self, frame: ndarray, time_s: float | None = None) -> Light | None:
        """The light after an upright frame, (h,w,3) of uint8, RGB, shown at ``time_s`` (now).

        The last one, not ``seen``, where no face is, or too little of one; None before the first.

        Raises
        ------
        InputError
            The frame is no picture of 8-bit RGB.
        """
        if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3 or not frame.size:
            raise InputError(
                f"frames are (height, width, 3) arrays of uint8, got {frame.shape} of {frame.dtype}"
            )
        time_s = time.monotonic() if time_s is None else time_s
        begun = time.thread_time()
        followed = self._follower.follow(frame)
        self.timing.landmarks_s.append(time.thread_time() - begun)
        begun = time.thread_time()
        new = self._found(frame, time_s) if followed else None
        self.timing.light_s.append(time.thread_time() - begun)
        if new is not None:
            self.light = new if self.light is None else blended(self.light, new)
        elif self.light is not None:
            self.light = replace(self.light, seen=False)
        return self.light

    def _found(self, frame: UInt8[ndarray, "h w 3"], time_s: float) -> Light | None:
        head = self._follower.head
        assert head is not None
        if self._of is not head:
            self._solver, self._of = LightSolver(head.skin), head
        assert self._solver is not None
        skin = self._follower.skin(frame)
        if skin is None:
            return None
        solution = self._solver.solve(skin.colours, skin.weights, head.state.rotation)
        return Light(
            time_s=time_s,
            direction=solution.direction,
            radius_90_rad=solution.radius_90_rad,
            irradiance=solution.irradiance,
            ambient=solution.ambient,
            harmonics=solution.harmonics,
        )


def blended(before: Light, new: Light) -> Light:
    """The light shown after ``before`` when ``new`` is found: the exponential mean in time.

    Its rate grows by 1 + (angle / a)^2, a being half the new direction's credible radius or 4
    degrees: what trembles is smoothed, and what jumps is followed at once.
    """
    cosine = float(np.clip(before.direction @ new.direction, -1, 1))
    least = max(_LEAST_JUMP_RAD, _JUMP_SHARE * new.radius_90_rad)
    rate = (1 + (math.acos(cosine) / least) ** 2) / SETTLE_S
    gain = 1 - math.exp(-rate * max(new.time_s - before.time_s, 0.0))
    mixed = {
        name: (1 - gain) * getattr(before, name) + gain * getattr(new, name)
        for name in ("direction", "radius_90_rad", "irradiance", "ambient", "harmonics")
    }
    length = float(np.linalg.norm(mixed["direction"]))
    mixed["direction"] = mixed["direction"] / length if length > 1e-6 else new.direction
    return replace(new, **mixed)
