"""Streets before a sky: posts of lamps, signs and wires, and roofs, beams and branches overhead."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from skylight.skies.surroundings._buildings import WALLS, Plan, cross
from skylight.skies.surroundings._layer import (
    EYE_M,
    MOST_ALBEDO,
    NOWHERE,
    SUN_HIDDEN,
    Draws,
    Layer,
    Range,
    Site,
    rough_noise,
    spread,
)
from skylight.skies.surroundings._terrain import LEAVES, THROUGH

METAL = ((0.1, 0.1, 0.1), (0.3, 0.3, 0.3), (0.5, 0.5, 0.48), (0.12, 0.09, 0.07))
TILE, CELL_M = 64, 0.25  # of leaves: samples a side, and their distance


@dataclass(frozen=True, kw_only=True)
class Posts:
    """``count`` upright strips, lit as walls that face the observer."""

    count: int
    distance_m: Range
    height_m: Range
    width_m: Range

    def layers(self, draws: Draws, site: Site) -> Iterator[Layer]:
        distance = draws.scale(self.distance_m, self.count)
        half = draws.scale(self.width_m, self.count) / distance / 2
        strip, which = site.view.across(draws.azimuth(self.count), half).max(1)
        top = torch.atan2(draws.scale(self.height_m, self.count) - EYE_M, distance)
        top = top.gather(1, which)
        site = site.up_to(float(top.max()))
        away, _ = site.view.frame
        received = site.light.irradiance(
            -away.expand(len(top), -1, -1), site.open[:, None, None], torch.tensor(1.0)
        )
        radiance = spread(draws.colour(METAL), received) * received / math.pi
        yield Layer(
            cover=strip[:, None] * site.view.between(torch.zeros_like(top), top),
            radiance=radiance[:, None].expand(-1, site.view.rows, -1, -1),
            distance_m=distance.gather(1, which),
        )


@dataclass(frozen=True, kw_only=True)
class Slabs:
    """Level rectangles overhead; a long narrow one looks like an arch from horizon to horizon.

    Their undersides get what light the ground sends up.
    """

    count: int
    above_m: Range  # the observer's eye
    width_m: Range
    length_m: Range
    distance_m: Range  # of their middles, on the ground

    def layers(self, draws: Draws, site: Site) -> Iterator[Layer]:
        above = draws.scale(self.above_m, self.count)[..., None]
        low, high = self._spans(draws, above, site)
        for i in range(self.count):
            albedo = draws.colour(WALLS) * draws.scale((0.1, 1.0), 1)  # in part hidden from light
            grain = torch.exp(0.15 * site.view.texture(draws, 0.8))[..., None]
            albedo = (albedo[:, None, None] * grain).clamp(max=MOST_ALBEDO)
            yield Layer(
                cover=site.view.between(low[:, i], high[:, i]),
                radiance=albedo * spread(site.light.ground, albedo) / math.pi,
                distance_m=above[:, i].expand_as(low[:, i]),
            )

    def _spans(
        self, draws: Draws, above: Float[Tensor, "b n 1"], site: Site
    ) -> tuple[Float[Tensor, "b n c"], Float[Tensor, "b n c"]]:
        """Elevations of their far and near ends along each part of a column."""
        sides = draws.scale(self.length_m, self.count), draws.scale(self.width_m, self.count)
        plan = Plan(
            azimuth=draws.azimuth(self.count),
            distance_m=draws.uniform(self.distance_m, self.count),
            half_m=torch.stack(sides, -1) / 2,
            turn=draws.uniform((-0.4, 0.4), self.count),
        )
        hit = cross(plan, site.view)
        low = torch.where(hit.hit, torch.atan2(above, hit.leave), NOWHERE)
        high = torch.where(hit.hit, torch.atan2(above, hit.enter), -NOWHERE)
        cut = site.light.before_sun(low, high) & ~draws.chance(SUN_HIDDEN, self.count)
        return torch.where(cut[..., None], NOWHERE, low), high


@dataclass(frozen=True, kw_only=True)
class Branches:
    """The crown of a tree overhead: leaves in a level disc, seen from below."""

    above_m: Range  # the observer's eye
    radius_m: Range
    offset: Range  # of its middle, over its radius

    def layers(self, draws: Draws, site: Site) -> Iterator[Layer]:
        view = site.view
        above, radius = draws.scale(self.above_m, 1, 1), draws.scale(self.radius_m, 1, 1)
        azimuth, offset = draws.azimuth(1, 1), draws.uniform(self.offset, 1, 1)
        middle = offset * radius * torch.sin(azimuth), -offset * radius * torch.cos(azimuth)
        shown = ~self._hides_sun(middle, above, radius, site) | draws.chance(SUN_HIDDEN, 1, 1)
        level = above / torch.tan(view.elevation)
        x = level * torch.sin(view.azimuth) - middle[0]
        z = -level * torch.cos(view.azimuth) - middle[1]
        dense = draws.uniform((0.8, 2.5), 1, 1)
        inside = (1 - torch.hypot(x, z) / radius).clamp(min=-3)
        leaves = 2 * dense * inside + _leaves(draws, x, z, 0.6)
        yield Layer(
            cover=(0.3 + 0.6 * leaves).clamp(0, 1) * shown,
            radiance=_shade(draws, _leaves(draws, x, z, 0.4) - dense, site),
            distance_m=above[:, 0].expand(-1, view.parts),
        )

    @staticmethod
    def _hides_sun(
        middle: tuple[Float[Tensor, "b 1 1"], Float[Tensor, "b 1 1"]],
        above: Float[Tensor, "b 1 1"],
        radius: Float[Tensor, "b 1 1"],
        site: Site,
    ) -> Bool[Tensor, "b 1 1"]:
        """Whether the crown, with a fifth of its radius about it, is before the sun."""
        x, y, z = (each[:, None, None] for each in site.light.sun.unbind(-1))
        seen = above * x / y.clamp(min=0.01), above * z / y.clamp(min=0.01)
        near = torch.hypot(seen[0] - middle[0], seen[1] - middle[1]) < 1.2 * radius
        return near & site.light.has_sun[:, None, None]


def _shade(draws: Draws, thin: Float[Tensor, "b h c"], site: Site) -> Float[Tensor, "b h c 3"]:
    """Leaves from below: they send back the ground's light, and let the sky's through."""
    light, leaf = site.light, draws.colour(LEAVES)
    up = leaf.new_tensor([0.0, 1.0, 0.0]).expand(len(leaf), 1, 3)
    above = light.irradiance(up, torch.tensor(1.0), torch.tensor(1.0))[:, 0]
    through = leaf * leaf.new_tensor(THROUGH) * above
    back = leaf * light.ground
    share = torch.sigmoid(1.5 * thin)[..., None]
    return (spread(back, share) + share * spread(through, share)) / math.pi


def _leaves(
    draws: Draws, x: Float[Tensor, "b h c"], z: Float[Tensor, "b h c"], roughness: float
) -> Float[Tensor, "b h c"]:
    """Noise at places on a level plane (m), from a tile that is repeated."""
    noise = rough_noise(draws, TILE, TILE, roughness)
    noise = functional.pad(noise[:, None], (0, 1, 0, 1), mode="circular")
    tiles = torch.stack([x, z], -1) / (TILE * CELL_M)
    place = 2 * torch.remainder(tiles, 1) - 1
    return functional.grid_sample(noise, place, align_corners=True)[:, 0]
