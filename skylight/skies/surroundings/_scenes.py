"""Scenes before skies: what may stand there and how often, what it covers, and its radiance."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.skies.surroundings._buildings import Buildings
from skylight.skies.surroundings._layer import (
    SNOW,
    Draws,
    Layer,
    Range,
    Site,
    View,
    in_air,
    light_of,
)
from skylight.skies.surroundings._street import Branches, Posts, Slabs
from skylight.skies.surroundings._terrain import Land, Trees

FIELDS = ((0.06, 0.09, 0.03), (0.12, 0.11, 0.05), (0.1, 0.09, 0.07), (0.04, 0.06, 0.025))
ROCKS = ((0.16, 0.14, 0.11), (0.06, 0.07, 0.04), (0.03, 0.045, 0.02))
WOODS = ((0.025, 0.035, 0.012), (0.04, 0.06, 0.02), (0.03, 0.03, 0.02), (0.08, 0.07, 0.04))
GROUNDS = ((0.06, 0.09, 0.03), (0.15, 0.14, 0.12), (0.25, 0.24, 0.22), (0.2, 0.16, 0.1))
SNOWY, MISTY = 1 / 12, 1 / 20  # shares of the scenes
CLEAR_M, MIST_M = (1e4, 8e4), (3e2, 3e3)  # visibility


class Kind(Protocol):
    """Things of one kind; ``layers`` draws some for each scene, the farthest first."""

    def layers(self, draws: Draws, site: Site) -> Iterator[Layer]: ...


@dataclass(frozen=True)
class Scene:
    """A kind of place: its ``share`` of all, how ``open`` it is, what is there how often."""

    share: float
    open: Range
    there: dict[str, float]


# The farthest first: what follows is before it. Ranges are from what is common to what is not
# rare; distances, heights and widths are scattered evenly in their logarithm.
# fmt: off
KINDS: dict[str, Kind] = {
    "mountains": Land(distance_m=(5e3, 3e4), level_deg=(2, 10), relief=(0.3, 0.6),
                      roughness=1.6, colours=ROCKS, snow_line=0.3),
    "hills": Land(distance_m=(800, 6e3), level_deg=(0.7, 5), relief=(0.3, 0.8),
                  roughness=1.8, colours=FIELDS),
    "woods": Land(distance_m=(100, 800), level_deg=(0.8, 5), relief=(0.3, 1),
                  roughness=0.8, colours=WOODS, lumps=0.8),
    "town": Buildings(count=12, distance_m=(80, 400), height_m=(4, 25), width_m=(8, 40),
                      gabled=0.4),
    "towers": Buildings(count=10, distance_m=(50, 300), height_m=(25, 140), width_m=(18, 50),
                        gabled=0.0, panes=(0.2, 0.9), mirror=(0.08, 0.4)),
    "trees": Trees(count=12, distance_m=(12, 80), height_m=(4, 18), rows=2),
    "bushes": Trees(count=24, distance_m=(6, 40), height_m=(2, 8), slender=(0.5, 1),
                    stem=(-0.1, 0.05), needles=0.1),
    "houses": Buildings(count=6, distance_m=(10, 50), height_m=(3, 12), width_m=(7, 20),
                        gabled=0.5),
    "thicket": Land(distance_m=(8, 40), level_deg=(5, 22), relief=(0.3, 0.7),
                    roughness=0.6, colours=WOODS, lumps=1.2),
    "forest": Trees(count=20, distance_m=(7, 45), height_m=(8, 26), slender=(0.2, 0.45),
                    rows=3, bare=0.2),
    "stems": Trees(count=14, distance_m=(4, 30), height_m=(12, 28), slender=(0.08, 0.16),
                   stem=(0.4, 0.7), rows=2, needles=0.1),
    "street": Buildings(count=7, distance_m=(4, 16), height_m=(5, 22), width_m=(10, 40),
                        gabled=0.2),
    "posts": Posts(count=5, distance_m=(6, 60), height_m=(3, 12), width_m=(0.1, 0.35)),
    "branches": Branches(above_m=(2, 7), radius_m=(2, 7), offset=(0.3, 1.4)),
    "beams": Slabs(count=3, above_m=(2, 12), width_m=(0.15, 1.5), length_m=(15, 80),
                   distance_m=(0, 12)),
    "roof": Slabs(count=1, above_m=(1.2, 6), width_m=(2.5, 10), length_m=(5, 40),
                  distance_m=(1, 7)),
}
# fmt: on
SCENES = {
    "plain": Scene(
        share=0.34,
        open=(0.9, 1),
        there={"mountains": 0.15, "hills": 0.4, "woods": 0.7, "town": 0.25, "posts": 0.1},
    ),
    "park": Scene(
        share=0.16,
        open=(0.6, 1),
        there={
            **{"hills": 0.2, "woods": 0.8, "town": 0.3, "trees": 1.0, "bushes": 0.3},
            **{"houses": 0.2, "posts": 0.2, "branches": 0.3},
        },
    ),
    "village": Scene(
        share=0.12,
        open=(0.6, 0.95),
        there={
            **{"mountains": 0.2, "hills": 0.4, "woods": 0.5, "town": 0.6, "trees": 0.6},
            **{"houses": 1.0, "posts": 0.3},
        },
    ),
    "forest": Scene(
        share=0.14,
        open=(0.1, 0.6),
        there={
            "woods": 1.0,
            "bushes": 0.7,
            "thicket": 0.6,
            "forest": 0.75,
            "stems": 0.4,
            "branches": 0.5,
        },
    ),
    "city": Scene(
        share=0.18,
        open=(0.4, 0.8),
        there={
            **{"town": 0.8, "towers": 0.5, "street": 0.6, "trees": 0.4, "posts": 0.3},
            **{"branches": 0.1},
        },
    ),
    "shelter": Scene(
        share=0.06,
        open=(0.5, 0.9),
        there={
            **{"woods": 0.6, "town": 0.5, "trees": 0.3, "posts": 0.6, "beams": 0.6},
            **{"roof": 0.6},
        },
    ),
}


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
