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
# Nats of evidence that one more lamp is to bring. What heads are wrong by is not as independent as
# the objective takes it to be, and lights a face as another lamp would: where the pictures of 15
# rendered faces under one sun were multiplied by smooth fields of 15 %, which makes residuals those
# of photographs, a second lamp brought up to 19.
LEAST_GAIN = 25.0
MAP_ROWS = 64
Point = TypeVar("Point")


@dataclass(frozen=True, kw_only=True)
class Fitted(Generic[Point]):
    """The best light of ``count`` lamps: a solver's own ``point``, and what numbers compete by."""

    count: int
    point: Point
    log_evidence: float


def as_many_as_pay(fitted: Callable[[int], Fitted[Point]]) -> Fitted[Point]:
    """No lamp, and one more as long as that brings :data:`LEAST_GAIN` of log evidence.

    ``fitted`` is asked for numbers of lamps in ascending order, up to :data:`MOST_LAMPS`.
    """
    best = fitted(0)
    for count in range(1, MOST_LAMPS + 1):
        more = fitted(count)
        if more.log_evidence < best.log_evidence + LEAST_GAIN:
            break
        best = more
    return best


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
