"""Skies and lamps compete for the same faces: the likelier model explains them."""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch

from skylight._names import LightName
from skylight.inverse._lamps import LampsProblem
from skylight.inverse._problem import LightProblem, solve
from skylight.inverse._result import Choice, Estimate
from skylight.inverse._sky import SkyProblem
from skylight.transport._observation import Observation
from skylight.work._progress import Progress

# Heads are wrong in more ways than the objective knows, so evidence is less than it seems. By how
# many nats lamps must be likelier than a sky was set by 46 rendered faces under simulated skies, on
# which they led by -52 to 38; of 150 faces, 46 among them, four led by more. The nats that make a
# choice e times as sure are set by hand: what is called a probability is not calibrated further.
LEAD, TEMPERATURE = 40.0, 40.0
# Means and standard deviations of the exposure value at ISO 100. Tables for hand-held meters
# (ANSI PH2.7-1986) have 12 in open shade and under heavy clouds to 15 in the sun, 12 and less from
# sunset on; 5 to 7 in homes, 7 to 8 in offices, 8 to 9 on stages, 8 to 11 in galleries.
OPEN_SKY_EXPOSURE, ROOM_EXPOSURE = (13.0, 1.5), (7.0, 2.0)
# A dark picture is taken outdoors after all, at dusk, a bright one in a studio, in the light of
# strobes: odds, by hand
DARK_OUTDOORS, BRIGHT_INDOORS = 1 / 20, 1 / 5

RIVALS: tuple[LightName, ...] = ("autoencoder", "lamps")


class AutoProblem(LightProblem):
    """The light of faces as a sky over ground or as lamps, whichever is likelier.

    The two are solved in turn, and compete by
    :func:`~skylight.inverse._solution.log_evidence`, in which lamps have to lead, and by
    what the ``exposure`` value of the picture tells (:func:`open_sky_log_odds`).
    """

    def __init__(self, sky: SkyProblem, lamps: LampsProblem, exposure: float | None = None) -> None:
        self.sky, self.lamps, self.exposure = sky, lamps, exposure

    @property
    def grid_height(self) -> int:
        return max(self.sky.grid_height, self.lamps.grid_height)

    @property
    def is_empty(self) -> bool:
        return self.sky.is_empty

    def add(self, observation: Observation, photo: int = 0) -> None:
        # rivals must explain the same, and skies do not explain what stands behind a face
        observation = replace(observation, background=None)
        self.sky.add(observation, photo)
        self.lamps.add(observation, photo)

    def _solve(self, progress: Progress) -> Estimate:
        return self._solve_each([self], progress)[0]

    @classmethod
    def _solve_each(cls, problems: Sequence["AutoProblem"], progress: Progress) -> list[Estimate]:
        """The likelier model's estimates, with what they were chosen from."""
        skies = solve([one.sky for one in problems], lambda share: progress(0.5 * share))
        lamps = solve([one.lamps for one in problems], lambda share: progress(0.5 + 0.5 * share))
        return [
            choose([sky, lit], one.exposure)
            for sky, lit, one in zip(skies, lamps, problems, strict=True)
        ]


def open_sky_log_odds(exposure: float | None) -> float:
    """log p(exposure | open sky) / p(exposure | none), 0 where the exposure is unknown.

    Of normal densities of the exposure value at ISO 100
    (:func:`~skylight.imaging._exif.exposure_value`), and no more than exceptions allow. Brighter
    than the sun makes it tells no more than the sun.
    """
    if exposure is None:
        return 0.0
    exposure = min(exposure, 16.0)
    sky, room = (
        -0.5 * ((exposure - mean) / spread) ** 2 - math.log(spread)
        for mean, spread in (OPEN_SKY_EXPOSURE, ROOM_EXPOSURE)
    )
    return min(max(sky - room, math.log(DARK_OUTDOORS)), -math.log(BRIGHT_INDOORS))


def choose(rivals: Sequence[Estimate], exposure: float | None = None) -> Estimate:
    """The likeliest of estimates of the same faces, each with its evidence.

    The probability has the log odds ``(difference - LEAD) / TEMPERATURE`` of the evidence and those
    of the ``exposure`` value.
    """
    evidence = {one.light: one.log_evidence for one in rivals if one.log_evidence is not None}
    odds = open_sky_log_odds(exposure)
    handicap = LEAD + TEMPERATURE * odds
    nats = [value - handicap * (name == "lamps") for name, value in evidence.items()]
    shares = torch.softmax(torch.tensor(nats).double() / TEMPERATURE, 0)
    best = int(shares.argmax())
    chosen = rivals[best]
    return replace(
        chosen,
        choice=Choice(
            probability=float(shares[best]),
            log_evidence=evidence,
            exposure_log_odds=odds,
        ),
    )
