"""Buildings: facades with windows, flat roofs and gables."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.skies.surroundings.draws import MOST_ALBEDO, Draws, Range
from skylight.skies.surroundings.fronts import Front, draw_front, draw_plan
from skylight.skies.surroundings.layer import SNOW, Layer, Site
from skylight.skies.surroundings.view import View

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
