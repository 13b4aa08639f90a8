"""How many lamps a picture tells of, and what they are in its units."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.inverse.result import Lamp
from skylight.models.lamps import LampsLight
from skylight.sphere.envmap import EnvironmentMap, luminance

MOST_LAMPS = 3
# Nats of evidence, see least_gain: set by hand, by 16 photographs under one lamp each (of which two
# lamps made up to 78 nats more, 44 degrees apart) and 14 rendered faces in rooms.
LEAST_GAIN, LEAST_GAIN_OF_NEAR = 10.0, 90.0
MAP_ROWS = 64
Point = TypeVar("Point")


@dataclass(frozen=True, kw_only=True)
class Fitted(Generic[Point]):
    """The best light of k lamps: a solver's own ``point``, and what numbers compete by."""

    point: Point
    directions: Float[Tensor, "k 3"]
    log_evidence: float


def as_many_as_pay(fitted: Callable[[int], Fitted[Point]], fewest: int) -> Fitted[Point]:
    """``fewest`` lamps, and one more as long as that brings :func:`least_gain` of log evidence.

    ``fitted`` is asked for numbers of lamps in ascending order, up to :data:`MOST_LAMPS`.
    """
    best = fitted(fewest)
    for count in range(fewest + 1, MOST_LAMPS + 1):
        more = fitted(count)
        if more.log_evidence < best.log_evidence + least_gain(more.directions):
            break
        best = more
    return best


def least_gain(directions: Float[Tensor, "k 3"]) -> float:
    """What the last of k lamps is to bring: with the least angle a between two, in nats::

        10 + 90 ((1 + cos a) / 2)^2

    What heads are wrong by is not as independent as the objective takes it to be: a lamp in two
    lights the face as one would light another's.
    """
    apart = directions @ directions.T - 2 * torch.eye(len(directions)).to(directions)
    return LEAST_GAIN + LEAST_GAIN_OF_NEAR * float(((1 + apart.max()) / 2).square())


@torch.no_grad()
def in_pictures_units(
    count: int, params: Float[Tensor, " p"], exposure: float | Float[Tensor, "3"]
) -> tuple[EnvironmentMap, tuple[Lamp, ...]]:
    """The map, of :data:`MAP_ROWS` rows, and its lamps, the strongest first; on the CPU.

    ``exposure`` is the picture's unit, or one for each colour.
    """
    model, params = LampsLight(count, MAP_ROWS), params.cpu()
    radiance = model(params) * exposure
    found = model.lamps(params)
    received = 4 * math.pi * found.energies * LampsLight.facing(found.widths_rad)
    lamps = [
        Lamp(
            direction=found.directions[k].double(),
            irradiance=received[k] * exposure * found.colours[k],
            spread_rad=float(found.widths_rad[k]),
        )
        for k in range(count)
    ]
    return (
        EnvironmentMap(radiance=radiance.reshape(MAP_ROWS, 2 * MAP_ROWS, 3)),
        tuple(sorted(lamps, key=lambda lamp: -float(luminance(lamp.irradiance)))),
    )
