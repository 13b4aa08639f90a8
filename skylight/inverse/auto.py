"""Skies and lamps compete for the same faces: the likelier model explains them."""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch

from skylight.inverse.lamps.problem import LampsProblem
from skylight.inverse.result import Choice, Estimate, Scene
from skylight.inverse.sky.problem import SkyProblem
from skylight.models.names import LightName
from skylight.sphere.frame import angle_between
from skylight.transport.observation import Observation
from skylight.work.progress import Progress

# Heads are wrong in more ways than the objective knows, so evidence is less than it seems. By how
# much lamps must be likelier than a sky, and the nats that make a choice e times as sure, are set
# by hand, by eight rendered faces under simulated suns and twelve under clouds: lamps led by -51
# to 37 nats there. What is called a probability is not calibrated further.
LEAD, TEMPERATURE = 10.0, 10.0
CAMERA_DIRECTION = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)  # from the face
FLASH_RAD = math.radians(12.0)  # a flash on a camera, seen from a portrait's distance, and doubt


RIVALS: tuple[LightName, ...] = ("autoencoder", "lamps")


class AutoProblem:
    """The light of faces as a sky over ground or as lamps, whichever is likelier.

    The two are solved in turn, and compete by
    :func:`~skylight.inverse.objective.evidence.log_evidence`, in which lamps have to lead.
    """

    uses_gloss = True

    def __init__(self, sky: SkyProblem, lamps: LampsProblem) -> None:
        self.sky, self.lamps = sky, lamps

    @property
    def grid_height(self) -> int:
        return max(self.sky.grid_height, self.lamps.grid_height)

    def add(self, observation: Observation, photo: int = 0) -> None:
        """One more face; photographs come in order, counted from 0."""
        self.sky.add(observation, photo)
        self.lamps.add(observation, photo)

    def solve(self, progress: Progress | None = None) -> Estimate:
        """The likelier model's estimate, with what it was chosen from.

        Raises
        ------
        InputError
            Nothing was added.
        """

        def told(share: float, before: float) -> None:
            if progress is not None:
                progress(before + share / 2)

        sky = self.sky.solve(lambda share: told(share, 0.0))
        return choose([sky, self.lamps.solve(lambda share: told(share, 0.5))])


def choose(rivals: Sequence[Estimate]) -> Estimate:
    """The likeliest of estimates of the same faces, each with its evidence.

    Raises
    ------
    ValueError
        One has none.
    """
    evidence = {one.light: one.log_evidence for one in rivals if one.log_evidence is not None}
    if len(evidence) < len(rivals):
        raise ValueError(f"only {list(evidence)} of {len(rivals)} estimates have evidence")
    nats = [value - LEAD * (name == "lamps") for name, value in evidence.items()]
    shares = torch.softmax(torch.tensor(nats).double() / TEMPERATURE, 0)
    best = int(shares.argmax())
    chosen = rivals[best]
    return replace(
        chosen,
        choice=Choice(
            scene=scene_of(chosen),
            probability=float(shares[best]),
            log_evidence=evidence,
        ),
    )


def scene_of(estimate: Estimate) -> Scene:
    """What an estimate's light is, in words."""
    if estimate.light != "lamps":
        return "open sky, sun" if estimate.posterior.is_seen else "open sky, overcast"
    if not estimate.posterior.is_seen:
        return "no open sky, even light"
    main = estimate.lamps[0].direction
    if len(estimate.lamps) == 1 and float(angle_between(main, CAMERA_DIRECTION)) < FLASH_RAD:
        return "no open sky, flash"
    counts: tuple[Scene, ...] = (
        "no open sky, one lamp",
        "no open sky, two lamps",
        "no open sky, three lamps",
    )
    return counts[len(estimate.lamps) - 1]
