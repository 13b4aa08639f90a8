"""Land along the horizon: mountains, hills, the edges of distant woods."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.skies.surroundings.draws import Colour, Draws, Range
from skylight.skies.surroundings.layer import SNOW, Layer, Site


@dataclass(frozen=True, kw_only=True)
class Land:
    """A skyline ``level_deg`` high on average, with ups and downs of ``relief`` times that."""

    distance_m: Range
    level_deg: Range
    relief: Range
    roughness: float  # of the profile: amplitude ~ frequency^-roughness
    colours: tuple[Colour, ...]
    snow_line: float = 0.0  # the share of scenes where its tops are white
    lumps: float = 0.3  # light and shadow on it, as a slope

    def layers(self, draws: Draws, site: Site) -> Iterator[Layer]:
        level = draws.scale(self.level_deg, 1) * math.pi / 180
        profile = site.view.profile(draws, self.roughness)
        top = level * (1 + draws.uniform(self.relief, 1) * profile)
        site = site.up_to(float(top.max()))
        view = site.view
        lumps = view.texture(draws, 0.6), view.texture(draws, 0.6)
        normal = _slopes(site, lumps, self.lumps, draws.uniform((0.5, 1.5), 1, 1))
        hollow = (0.7 + 0.2 * lumps[1]).clamp(0.2, 1)[..., None]
        received = site.light.irradiance(normal, hollow * site.open[:, None, None, None], hollow)
        albedo = draws.colour(self.colours)[:, None, None].expand_as(received)
        height = view.elevation / level.clamp(min=1e-3)[:, None] + 0.3 * lumps[0]
        line = torch.where(draws.chance(self.snow_line, 1, 1), draws.uniform((0.3, 1.2), 1, 1), 9.0)
        white = ((height - line) * 4).clamp(0, 1).maximum(site.snow[:, None, None] * 0.7)
        albedo = albedo + (SNOW - albedo) * white[..., None]
        yield Layer(
            cover=view.between(torch.zeros_like(top), top.clamp(min=0)),
            radiance=albedo / math.pi * received,
            distance_m=draws.scale(self.distance_m, 1).expand_as(top),
        )


def _slopes(
    site: Site,
    lumps: tuple[Float[Tensor, "b h c"], Float[Tensor, "b h c"]],
    strength: float,
    steepness: Float[Tensor, "b 1 1"],
) -> Float[Tensor, "b h c 3"]:
    """Normals of slopes that rise away from the observer, uneven in both directions."""
    away, right = site.view.frame
    up = away.new_tensor([0.0, 1.0, 0.0])
    towards = (steepness + strength * lumps[0])[..., None]
    normal = up - towards * away + strength * 1.5 * lumps[1][..., None] * right
    return normal / normal.norm(dim=-1, keepdim=True)
