"""Where the sun stands by clock, place and compass: a prior over its direction.

Time and place tell the sun's height exactly, and with the camera's heading its direction s. What
is known of s in the camera's frame is less sure: the camera is not quite level, which spreads s
in a von Mises-Fisher density F of concentration k, and the compass is wrong, which turns s about
the vertical by an angle with a von Mises density M of concentration c (0 where there is no
heading). Together::

    p(d) = int M(a; c) F(d; R_a s, k) da
         = k / (2 pi (1 - exp(-2 k))) exp(k (cos z cos z_s - 1)) I_0(r) / I_0(c),
    r^2 = b^2 + c^2 + 2 b c cos(a_d - a_s),    b = k sin z sin z_s

with zenith angles z and azimuths a: the exponents of M and F add up to that of one cosine. With
c = 0 it is a ring at the height of s. Of skies the density is cut at the horizon and normalised
above it, by quadrature over the height; of light of the whole sphere it is not: cameras are tilted,
and a low sun may be below their horizon.

Clocks are wrong, cameras' zones are not set and compasses lie beside metal: a share of
:data:`FLOOR` is uniform over the upper hemisphere. What a time without a zone may mean is a
mixture of such densities. Where the main light may be a lamp or a window, a share more is uniform,
over the sphere (:meth:`SunPrior.anywhere`).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight.imaging._capture_metadata import CaptureMetadata
from skylight.skies._sun import Place, sun_angles
from skylight.sphere._frame import angles_from_direction

FLOOR = 0.1
TILT_RAD = math.radians(6.0)  # of hand-held cameras per axis, fitted heads' error included
TROPIC_DEG = 23.44  # between the tropics clocks are not changed for the summer
ASIDE_RAD = math.radians(3.0)  # of a light found in simpler light, along its azimuth, besides
_NODES = 256  # of the quadrature; a lobe of 6 degrees is 25 of them wide


@dataclass(frozen=True, kw_only=True)
class SunPart:
    """A sun that time and place allow, with its ``share``; azimuths are in the camera's frame.

    ``turn`` is the concentration c of the azimuth, 0 where it is unknown.
    """

    share: float
    zenith_rad: float
    azimuth_rad: float = 0.0
    turn: float = 0.0

    def log_density(self, directions: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b"]:
        """ln p of the module's text at directions above the horizon, per sr."""
        return self.uncut_log_density(directions) - math.log(self._above())

    def uncut_log_density(self, directions: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b"]:
        """The same on the whole sphere."""
        k, c = 1 / TILT_RAD**2, self.turn
        x, y, z = directions.unbind(-1)
        across, up = math.sin(self.zenith_rad), math.cos(self.zenith_rad)
        towards = x * math.sin(self.azimuth_rad) - z * math.cos(self.azimuth_rad)
        squared = (k * across) ** 2 * (x * x + z * z) + c * c + 2 * k * c * across * towards
        r = squared.clamp(min=1e-12).sqrt()
        # i0e(x) = I_0(x) exp(-x)
        turned = torch.special.i0e(r).log() + r - _log_i0(c)
        return math.log(k / (2 * math.pi * -math.expm1(-2 * k))) + k * (y * up - 1) + turned

    def _above(self) -> float:
        """The share above the horizon, which no turn about the vertical changes."""
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        height = torch.from_numpy((nodes + 1) / 2)
        slanted = (1 - height * height).sqrt()
        ring = SunPart(share=1.0, zenith_rad=self.zenith_rad)
        along = torch.stack([torch.zeros_like(height), height, -slanted], 1)
        density = ring.uncut_log_density(along).exp()
        return float(2 * math.pi * density @ torch.from_numpy(weights / 2))


@dataclass(frozen=True, kw_only=True)
class SunPrior:
    """A density over the directions of the upper hemisphere: ``parts``, whose shares sum to 1.

    :data:`FLOOR` of it is uniform. With ``sphere`` it is one over all directions, of the main light
    of a place that has a probability to be under the ``open_sky``: elsewhere that light may come
    from anywhere.
    """

    parts: tuple[SunPart, ...]
    sphere: bool = False
    open_sky: float = 1.0

    def anywhere(self, open_sky: float) -> "SunPrior | None":
        """Of the main light of any place; None where that is not under the ``open_sky`` at all."""
        return replace(self, sphere=True, open_sky=open_sky) if open_sky > 0 else None

    def log_density(self, directions: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b"]:
        """ln of the whole density, per sr; smooth in the directions."""
        clock = self.clock_log_density(directions) + math.log(1 - self.floor)
        return torch.logaddexp(clock, torch.full_like(clock, math.log(self.elsewhere)))

    def of_one(self, directions: Float[Tensor, "*b k 3"]) -> Float[Tensor, "*b"]:
        """ln of the density where one of k lights, each alike, is the main one, and the others may
        be anywhere: by how much that is more than an even one does not grow with k."""
        return self.log_density(directions).logsumexp(-1) - math.log(directions.shape[-2])

    def clock_log_density(self, directions: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b"]:
        """The density were clock and compass right, and the main light the sun."""
        parts = [
            (part.uncut_log_density if self.sphere else part.log_density)(directions)
            + math.log(part.share)
            for part in self.parts
        ]
        return torch.stack(parts).logsumexp(0)

    @property
    def floor(self) -> float:
        """The share that is uniform."""
        return 1 - (1 - FLOOR) * self.open_sky

    @property
    def area(self) -> float:
        """Of all directions, sr."""
        return (4 if self.sphere else 2) * math.pi

    @property
    def elsewhere(self) -> float:
        """The density of what is not where the clock says, per sr."""
        return self.floor / self.area

    def likely(self, directions: Float[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
        """Where the clock says more than that it may be wrong."""
        return self.log_density(directions) > math.log(2 * self.elsewhere)


def sun_prior(taken: CaptureMetadata) -> tuple[SunPrior | None, tuple[str, ...]]:
    """(what the facts tell of the sun, what to know of that); None where they tell nothing.

    That is without a time or a place, and where the sun was below the horizon.
    """
    if taken.time is None or taken.latitude_deg is None or taken.longitude_deg is None:
        return None, ()
    place = Place(latitude_deg=taken.latitude_deg, longitude_deg=taken.longitude_deg)
    shares, times = zip(*_moments(taken.time, place), strict=True)
    azimuths, zeniths = sun_angles(place, list(times))
    heading, turn = 0.0, 0.0
    if taken.heading_deg is not None:
        heading = math.radians(taken.heading_deg)
        turn = 1 / math.radians(taken.heading_error_deg) ** 2
    up = [k for k, zenith in enumerate(zeniths) if zenith < math.pi / 2]
    if not up:
        return None, ("the sun was below the horizon at that time and place: they were not used",)
    whole = math.fsum(shares[k] for k in up)
    parts = [
        SunPart(
            share=shares[k] / whole,
            zenith_rad=float(zeniths[k]),
            azimuth_rad=float(azimuths[k]) - heading,
            turn=turn,
        )
        for k in up
    ]
    prior = SunPrior(parts=tuple(parts))
    if taken.time.tzinfo is None:
        return prior, ("the time has no time zone: those usual at its longitude were tried",)
    return prior, ()


def found_light(direction: Float[Tensor, "3"]) -> SunPrior:
    """Of a main light that was found there by other means, wherever that place is.

    It is :data:`TILT_RAD` off per axis, and a share of :data:`FLOOR` is uniform.
    """
    azimuth, zenith = (float(angle) for angle in angles_from_direction(direction))
    part = SunPart(share=1.0, zenith_rad=zenith, azimuth_rad=azimuth, turn=ASIDE_RAD**-2)
    return SunPrior(parts=(part,), sphere=True)


def zone_offsets(place: Place, month: int) -> dict[int, float]:
    """How likely clocks are ahead of UTC by so many hours.

    The zone of the longitude, round(longitude / 15), or the next to the east, in which much of
    the world's west coasts, Spain and Argentina live; an hour more where it may be summer time,
    March to November in the north and September to April in the south, with a chance of a half.
    """
    usual = round(place.longitude_deg / 15)
    shares = {usual: 0.7, usual + 1: 0.3}
    north = place.latitude_deg > 0
    summer = 3 <= month <= 11 if north else month >= 9 or month <= 4
    if not summer or abs(place.latitude_deg) < TROPIC_DEG:
        return shares
    either = dict.fromkeys(range(usual, usual + 3), 0.0)
    for hours, share in shares.items():
        either[hours] += share / 2
        either[hours + 1] += share / 2
    return either


def _moments(time: datetime, place: Place) -> Iterator[tuple[float, datetime]]:
    """(share, moment): what a clock there may have meant."""
    if time.tzinfo is not None:
        yield 1.0, time
        return
    for hours, share in zone_offsets(place, time.month).items():
        yield share, (time - timedelta(hours=hours)).replace(tzinfo=UTC)


def _log_i0(x: float) -> float:
    return math.log(float(torch.special.i0e(torch.tensor(x, dtype=torch.float64)))) + x
