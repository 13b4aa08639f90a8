"""Scenes before skies: what covers each pixel, and its radiance."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.skies.surroundings.draws import Draws
from skylight.skies.surroundings.kinds import KINDS, SCENES
from skylight.skies.surroundings.layer import SNOW, Site, in_air
from skylight.skies.surroundings.light import light_of
from skylight.skies.surroundings.view import View

GROUNDS = ((0.06, 0.09, 0.03), (0.15, 0.14, 0.12), (0.25, 0.24, 0.22), (0.2, 0.16, 0.1))
SNOWY, MISTY = 1 / 12, 1 / 20  # shares of the scenes
CLEAR_M, MIST_M = (1e4, 8e4), (3e2, 3e3)  # visibility


def surroundings(
    skies: Float[Tensor, "b h w 3"], generator: torch.Generator
) -> tuple[Float[Tensor, "b h w 1"], Float[Tensor, "b h w 3"]]:
    """(how much of each pixel something covers, the radiance of what covers it).

    A scene for each sky by :data:`SCENES`, of things of :data:`KINDS`. Surfaces are Lambertian
    and lit by the sky itself (:class:`Light`); the air before them is hazy. Before a uniform sky
    nothing is brighter than it. The same generator before the same sky gives the same scene, at
    any height of the maps. Computed on the CPU, in float32.
    """
    view, draws = View(skies.shape[1]), Draws(count=len(skies), generator=generator)
    scene = draws.choice([each.share for each in SCENES.values()])
    site = _site(skies, view, scene, draws)
    free = torch.ones(len(skies), view.height, view.parts)
    light = torch.zeros(*free.shape, 3)
    for name, kind in KINDS.items():
        shares = torch.tensor([each.there.get(name, 0.0) for each in SCENES.values()])
        there = (draws.uniform((0.0, 1.0)) < shares[scene]).nonzero()[:, 0]
        if not len(there):
            continue
        here = site.of(there)
        for layer in kind.layers(Draws(count=len(there), generator=generator), here):
            rows = slice(-layer.cover.shape[1], None)
            left = 1 - layer.cover
            sent = in_air(layer, here) * layer.cover[..., None]
            light[there, rows] = light[there, rows] * left[..., None] + sent
            free[there, rows] = free[there, rows] * left
    cover = view.pixels(1 - free[..., None]).clamp(max=1)
    return cover, view.pixels(light) / cover.clamp(min=1e-6)


def _site(
    skies: Float[Tensor, "b h w 3"], view: View, scene: Int[Tensor, " b"], draws: Draws
) -> Site:
    low, high = torch.tensor([each.open for each in SCENES.values()])[scene].unbind(-1)
    free = low + (high - low) * draws.uniform((0.0, 1.0))
    snow = draws.chance(SNOWY).float()
    ground = draws.colour(GROUNDS)
    ground = ground + (SNOW - ground) * snow[:, None]
    clear, mist = draws.scale(CLEAR_M), draws.scale(MIST_M)
    return Site(
        view=view,
        light=light_of(skies, view, ground * free[:, None]),  # what shades walls shades it too
        open=free,
        visibility_m=torch.where(draws.chance(MISTY), mist, clear),
        snow=snow,
    )
