"""Posts of lamps, signs and wires."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch

from skylight.skies.surroundings.draws import Draws, Range
from skylight.skies.surroundings.layer import EYE_M, Layer, Site
from skylight.skies.surroundings.light import spread

METAL = ((0.1, 0.1, 0.1), (0.3, 0.3, 0.3), (0.5, 0.5, 0.48), (0.12, 0.09, 0.07))


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
