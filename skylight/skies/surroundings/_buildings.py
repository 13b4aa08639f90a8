"""Buildings before a sky: boxes in plan, and facades with windows, flat roofs and gables.

Each column of the map sees a box through an interval of elevation; the facade that it sees there,
and where on it, decide what is painted.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.skies.surroundings._layer import (
    EYE_M,
    MOST_ALBEDO,
    NOWHERE,
    SNOW,
    SUN_HIDDEN,
    Draws,
    Layer,
    Range,
    Site,
    View,
)

WALLS = (
    (0.55, 0.53, 0.5),  # white paint
    (0.45, 0.37, 0.27),  # sandstone
    (0.42, 0.28, 0.17),  # ochre
    (0.52, 0.38, 0.16),  # yellow plaster
    (0.48, 0.28, 0.19),  # pink plaster
    (0.36, 0.16, 0.09),  # terracotta
    (0.25, 0.13, 0.09),  # brick
    (0.3, 0.29, 0.27),  # concrete
    (0.13, 0.13, 0.13),  # dark cladding
)
ROOFS = ((0.25, 0.11, 0.07), (0.09, 0.09, 0.1), (0.28, 0.28, 0.27), (0.15, 0.1, 0.07))
ROOF_RAD = math.radians(40)  # the slope by which roofs are lit
STOREY_M, BAY_M = 3.2, 3.0


@dataclass(frozen=True, kw_only=True)
class Plan:
    """``n`` rectangles on the ground: where their middles are, half their sides, their turn."""

    azimuth: Float[Tensor, "b n"]
    distance_m: Float[Tensor, "b n"]
    half_m: Float[Tensor, "b n 2"]
    turn: Float[Tensor, "b n"]  # of the first side, from the line of sight's right


@dataclass(frozen=True, kw_only=True)
class Hit:
    """Where the level ray through each part of a column enters and leaves a rectangle.

    ``place`` is where on its side it enters, in metres from the side's middle, ``ridge`` how
    far off it crosses the line through the middle along the first side.
    """

    hit: Bool[Tensor, "b n c"]
    enter: Float[Tensor, "b n c"]
    leave: Float[Tensor, "b n c"]
    ridge: Float[Tensor, "b n c"]
    place: Float[Tensor, "b n c"]
    gable: Bool[Tensor, "b n c"]  # it enters through a second side, across the ridge
    normal: Float[Tensor, "b n c 3"]  # level, of the side through which it enters


def cross(plan: Plan, view: View) -> Hit:
    """Rays against rectangles, by the slab method; rays from inside enter at 0."""
    side = plan.azimuth + plan.turn  # the azimuth that the second axis points to
    away = view.azimuth - side[..., None]
    # along the first axis (90 degrees to the right of the second) and the second
    step = torch.stack([torch.sin(away), torch.cos(away)], -1)
    step = torch.where(step.abs() < 1e-6, 1e-6, step)
    start = plan.distance_m[..., None] * torch.stack(
        [torch.sin(plan.turn), -torch.cos(plan.turn)], -1
    )  # the observer, from the rectangle's middle
    start, half = start[:, :, None], plan.half_m[:, :, None]
    one, other = (-half - start) / step, (half - start) / step
    enters, leaves = torch.minimum(one, other), torch.maximum(one, other)
    enter, axis = enters.max(-1)
    leave = leaves.amin(-1)
    enter = enter.clamp(min=0)
    gable = axis == 0
    at = start + enter[..., None] * step
    sign = -torch.sign(step)
    toward = torch.where(gable, side[..., None] + math.pi / 2, side[..., None].expand_as(enter))
    sign = torch.where(gable, sign[..., 0], sign[..., 1])
    normal = torch.stack([torch.sin(toward), torch.zeros_like(toward), -torch.cos(toward)], -1)
    return Hit(
        hit=leave > enter,
        enter=enter,
        leave=leave,
        ridge=(-start[..., 1] / step[..., 1]).clamp(min=0),
        place=torch.where(gable, at[..., 1], at[..., 0]),
        gable=gable,
        normal=sign[..., None] * normal,
    )


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


@dataclass(frozen=True, kw_only=True)
class Buildings:
    """Up to ``count`` boxes; ``width_m`` of either side, the nearest ``distance_m`` off."""

    count: int
    distance_m: Range
    height_m: Range
    width_m: Range
    gabled: float = 0.3  # the share with gables
    panes: Range = (0.0, 0.45)  # share of a facade that is windows
    mirror: Range = (0.04, 0.1)  # what a pane sends back of the light before it

    def layers(self, draws: Draws, site: Site) -> Iterator[Layer]:
        """Roofs, walls."""
        plan = draw_plan(draws, self.count, distance_m=self.distance_m, width_m=self.width_m)
        front = draw_front(draws, plan, site, height_m=self.height_m, gabled=self.gabled)
        site = site.up_to(float(front.ridge.max()))
        eaves = front.eaves.clamp(min=0)
        yield Layer(
            cover=site.view.between(eaves, front.ridge),
            radiance=_roof_light(front, draws.colour(ROOFS, self.count), site),
            distance_m=front.distance_m,
        )
        yield Layer(
            cover=site.view.between(torch.zeros_like(eaves), front.eaves),
            radiance=_wall_light(front, self._facade(front, draws), draws, site),
            distance_m=front.distance_m,
        )

    def _facade(self, front: Front, draws: Draws) -> "Facade":
        street = draws.colour(WALLS)[:, None]  # buildings of one place are alike
        shaded = draws.uniform((-1.0, 0.7), self.count, 1).clamp(min=0)
        return Facade(
            albedo=front.each((street + draws.colour(WALLS, self.count)) / 2),
            panes=front.each(draws.uniform(self.panes, self.count, 1)),
            mirror=front.each(draws.uniform(self.mirror, self.count, 1)),
            shadow=front.each(shaded)[..., 0] * front.eaves.clamp(min=0),
        )


@dataclass(frozen=True, kw_only=True)
class Facade:
    """What a facade is of where it is seen; what stands opposite shades it up to ``shadow``."""

    albedo: Float[Tensor, "b c 3"]
    panes: Float[Tensor, "b c 1"]
    mirror: Float[Tensor, "b c 1"]
    shadow: Float[Tensor, "b c"]  # elevation


def _wall_light(front: Front, facade: Facade, draws: Draws, site: Site) -> Float[Tensor, "b h c 3"]:
    """Lambertian walls, for which more of the sky is free further up, and panes.

    Panes mirror: half of what they show is the sky above the horizon, half all the light.
    """
    light, view = site.light, site.view
    height = front.distance_m[:, None] * torch.tan(view.elevation)
    free = site.open[:, None, None] * (0.6 + 0.4 * (height / 10).clamp(0, 1))
    diffuse = light.diffuse(front.normal)[:, None] * free[..., None]
    beam = light.towards_sun(front.normal).clamp(min=0) * light.beam[:, None]
    lit = view.between(facade.shadow, torch.full_like(facade.shadow, math.pi / 2))[..., None]
    received = diffuse + beam[:, None] * lit + light.from_ground(front.normal)[:, None]
    grain = torch.exp(0.1 * view.texture(draws, 0.5))[..., None]
    sent = (facade.albedo[:, None] * grain).clamp(max=MOST_ALBEDO) * received
    shown = facade.mirror[:, None] * (diffuse + light.horizon[:, None] * math.pi / 2)
    panes = _windows(front, height, facade.panes[..., 0], view)
    return (sent + panes * (shown - sent)) / math.pi


def _windows(
    front: Front, height_m: Float[Tensor, "b h c"], share: Float[Tensor, "b c"], view: View
) -> Float[Tensor, "b h c 1"]:
    """How much of a pixel is panes: rows of windows, even grey where they are too small."""
    side = torch.sqrt(share)[:, None]
    distance = front.distance_m[:, None].clamp(min=1)
    across = distance * (2 * math.pi / view.parts)
    up = distance * (math.pi / 2 / view.height) * (1 + (height_m / distance).square())
    columns = _pulse(front.place_m[:, None] / BAY_M, side, across / BAY_M)
    return (columns * _pulse(height_m / STOREY_M, side, up / STOREY_M))[..., None]


def _pulse(x: Tensor, share: Tensor, width: Tensor) -> Tensor:
    """Mean, from x - width/2 to x + width/2, of a wave of period 1 that is 1 for ``share`` of it.

    Of its integral I: (I(x + width/2) - I(x - width/2)) / width.
    """

    def integral(t: Tensor) -> Tensor:
        whole = torch.floor(t)
        return whole * share + (t - whole - (1 - share) / 2).clamp(min=0).minimum(share)

    return (integral(x + width / 2) - integral(x - width / 2)) / width


def _roof_light(
    front: Front, albedo: Float[Tensor, "b n 3"], site: Site
) -> Float[Tensor, "b h c 3"]:
    up = front.normal.new_tensor([0.0, 1.0, 0.0])
    normal = math.sin(ROOF_RAD) * front.normal + math.cos(ROOF_RAD) * up
    received = site.light.irradiance(normal, site.open[:, None, None], torch.tensor(1.0))
    seen = front.each(albedo)
    seen = seen + (SNOW - seen) * site.snow[:, None, None]
    return (seen / math.pi * received)[:, None].expand(-1, site.view.rows, -1, -1)
