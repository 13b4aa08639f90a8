"""Facades: which building each column sees, and where on it."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.skies.surroundings.blocks import Hit, Plan, cross
from skylight.skies.surroundings.draws import Draws, Range
from skylight.skies.surroundings.layer import EYE_M, NOWHERE, SUN_HIDDEN, Site


@dataclass(frozen=True, kw_only=True)
class Front:
    """What each part of a column sees of the nearest building there."""

    distance_m: Float[Tensor, "b c"]
    place_m: Float[Tensor, "b c"]  # along the facade, from its middle
    normal: Float[Tensor, "b c 3"]
    eaves: Float[Tensor, "b c"]  # elevation of the wall's top
    ridge: Float[Tensor, "b c"]  # and of the roof's
    number: Int[Tensor, "b c"]

    def each(self, values: Float[Tensor, "b n k"]) -> Float[Tensor, "b c k"]:
        """The buildings' values where they are seen."""
        index = self.number[..., None].expand(-1, -1, values.shape[-1])
        return values.gather(1, index)


def draw_plan(draws: Draws, count: int, *, distance_m: Range, width_m: Range) -> Plan:
    """Buildings whose longer side roughly faces the observer, ``distance_m`` off him.

    The distance is that to the nearest side along the line to the building's middle.
    """
    half = draws.scale(width_m, count, 2).sort(-1, descending=True).values / 2
    turn = draws.uniform((-0.6, 0.6), count)
    sin, cos = torch.sin(turn).abs().clamp(min=1e-3), torch.cos(turn)
    inside = torch.minimum(half[..., 0] / sin, half[..., 1] / cos)
    return Plan(
        azimuth=draws.azimuth(count),
        distance_m=draws.scale(distance_m, count) + inside,
        half_m=half,
        turn=turn,
    )


def draw_front(draws: Draws, plan: Plan, site: Site, *, height_m: Range, gabled: float) -> Front:
    """Some to all of the buildings, most of those before the sun left out."""
    hit, count = cross(plan, site.view), plan.turn.shape[1]
    eaves, ridge = _tops(draws, plan, hit, height_m, gabled)
    low = torch.where(hit.hit, 0.0, NOWHERE)
    cut = site.light.before_sun(low, torch.where(hit.hit, ridge, -NOWHERE))
    cut = cut & ~draws.chance(SUN_HIDDEN, count)
    seen = hit.hit & (draws.some(count) & ~cut)[..., None]
    number = torch.where(seen, hit.enter, torch.inf).argmin(1)

    def at(values: Float[Tensor, "b n c"]) -> Float[Tensor, "b c"]:
        return values.gather(1, number[:, None])[:, 0]

    return Front(
        distance_m=at(hit.enter),
        place_m=at(hit.place),
        normal=torch.stack([at(axis) for axis in hit.normal.unbind(-1)], -1),
        eaves=torch.where(seen.any(1), at(eaves), -NOWHERE),
        ridge=torch.where(seen.any(1), at(ridge), -NOWHERE),
        number=number,
    )


def _tops(
    draws: Draws, plan: Plan, hit: Hit, height_m: Range, gabled: float
) -> tuple[Float[Tensor, "b n c"], Float[Tensor, "b n c"]]:
    """Elevations of walls' and roofs' upper ends; a flat roof is not seen.

    A gable's wall rises to the ridge in its middle; over the long sides the roof rises behind
    the wall, to where the ray passes under the ridge or leaves the building.
    """
    count = plan.turn.shape[1]
    above = draws.scale(height_m, count)[..., None] - EYE_M
    deep = plan.half_m[..., 1:]
    rise = deep * (draws.uniform((0.4, 1.0), count) * draws.chance(gabled, count))[..., None]
    gable = above + rise * (1 - hit.place.abs() / deep).clamp(0, 1)
    eaves = torch.atan2(torch.where(hit.gable, gable, above), hit.enter)
    back = torch.minimum(hit.ridge, hit.leave).maximum(hit.enter)
    ridge = torch.atan2(
        above + rise * ((back - hit.enter) / (hit.ridge - hit.enter).clamp(min=1e-3)).clamp(0, 1),
        back,
    )
    return eaves, torch.where(hit.gable, eaves, torch.maximum(eaves, ridge))
