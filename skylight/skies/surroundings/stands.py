"""Stands of trees: where each column sees which crown, and which trunks."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.skies.surroundings.draws import Draws, Range
from skylight.skies.surroundings.layer import EYE_M, NOWHERE, SUN_HIDDEN, Site

FRINGE = 1.3  # how far leaves reach beyond a crown's ellipse, over its size


@dataclass(frozen=True, kw_only=True)
class Stand:
    """``n`` trees in plan: crowns are ellipsoids, or cones where ``pointed``."""

    azimuth: Float[Tensor, "b n"]
    distance_m: Float[Tensor, "b n"]
    height_m: Float[Tensor, "b n"]
    radius_m: Float[Tensor, "b n"]
    stem_m: Float[Tensor, "b n"]  # height of a crown's lower end
    trunk_m: Float[Tensor, "b n"]  # half its thickness
    pointed: Bool[Tensor, "b n"]
    standing: Bool[Tensor, "b n"]


@dataclass(frozen=True, kw_only=True)
class Crown:
    """For each part of a column the tree that is seen there, and where in its crown one looks.

    ``across`` and ``up`` are -1 to 1 from side to side and from the lower end to the top;
    ``within`` is 0 in the middle and 1 on the outline, ``reach`` the cover of a solid crown with
    its fringe.
    """

    across: Float[Tensor, "b c"]
    up: Float[Tensor, "b h c"]
    within: Float[Tensor, "b h c"]
    reach: Float[Tensor, "b h c"]
    distance_m: Float[Tensor, "b c"]
    tree: Int[Tensor, "b c"]
    top: float  # the highest elevation of all


def draw_stand(
    draws: Draws,
    count: int,
    *,
    distance_m: Range,
    height_m: Range,
    slender: Range,
    stem: Range,
    pointed: float,
) -> Stand:
    """Trees anywhere round the observer, some to all of ``count``; crowns keep off him."""
    distance, height = draws.scale(distance_m, count), draws.scale(height_m, count)
    sharp = draws.chance(pointed, count)
    wide = height * draws.uniform(slender, count)
    foot = torch.where(sharp, 0.06, draws.uniform(stem, count))
    return Stand(
        azimuth=draws.azimuth(count),
        distance_m=distance,
        height_m=height,
        radius_m=torch.where(sharp, 0.8 * wide, wide).minimum(0.7 * distance),
        stem_m=foot * height,
        trunk_m=height * draws.uniform((0.006, 0.014), count),
        pointed=sharp,
        standing=draws.some(count),
    )


def look(stand: Stand, draws: Draws, site: Site) -> tuple[Crown, Stand]:
    """(the crowns that are seen, the stand less the trees cut before the sun)."""
    away = site.view.azimuth - stand.azimuth[..., None]
    across = torch.sin(away) * (stand.distance_m / stand.radius_m)[..., None]
    level = stand.distance_m[..., None] * torch.cos(away)  # to the crown's middle
    base = torch.atan2((stand.stem_m - EYE_M)[..., None], level.clamp(min=0.1))
    top = torch.atan2((stand.height_m - EYE_M)[..., None], level.clamp(min=0.1))
    seen = (across.abs() < FRINGE) & (level > 0) & stand.standing[..., None]
    low, high = _outline(stand, across, base, top)
    low, high = torch.where(seen, low, NOWHERE), torch.where(seen, high, -NOWHERE)
    cut = site.light.before_sun(low, high) & ~draws.chance(SUN_HIDDEN, len(across[0]))
    seen = seen & ~cut[..., None]
    # the one that fills most of the column, so that crowns join where they are equally deep
    tree = torch.where(seen, high - low, -torch.inf).argmax(1)

    def at(values: Float[Tensor, "b n c"]) -> Float[Tensor, "b c"]:
        return values.gather(1, tree[:, None])[:, 0]

    low, high, base, top, across = (at(each) for each in (low, high, base, top, across))
    low = torch.where(seen.any(1), low, NOWHERE)
    highest = float(torch.where(seen.any(1), high, 0.0).max())
    view = site.view.up_to(highest)
    up = 2 * (view.elevation - base[:, None]) / (top - base).clamp(min=1e-3)[:, None] - 1
    crown = Crown(
        across=across,
        up=up.clamp(-1, 1),
        within=_within(stand.pointed.gather(1, tree)[:, None], across[:, None], up),
        reach=view.between(low, high),
        distance_m=stand.distance_m.gather(1, tree),
        tree=tree,
        top=highest,
    )
    return crown, _without(stand, cut)


def _outline(
    stand: Stand,
    across: Float[Tensor, "b n c"],
    base: Float[Tensor, "b n c"],
    top: Float[Tensor, "b n c"],
) -> tuple[Float[Tensor, "b n c"], Float[Tensor, "b n c"]]:
    """The lower and upper elevation of crowns with their fringe along each part of a column."""
    middle, half = (base + top) / 2, (top - base) / 2
    chord = half * torch.sqrt((FRINGE**2 - across.square()).clamp(min=0))
    pointed = stand.pointed[..., None]
    cone = base + 2 * half * (FRINGE - across.abs()).clamp(min=0)
    return torch.where(pointed, base, middle - chord), torch.where(pointed, cone, middle + chord)


def _within(
    pointed: Bool[Tensor, "b 1 c"], across: Float[Tensor, "b 1 c"], up: Float[Tensor, "b h c"]
) -> Float[Tensor, "b h c"]:
    cone = across.abs() / ((1.1 - up) / 2).clamp(min=0.05)
    return torch.where(pointed, cone, torch.hypot(across, up)).clamp(max=3)


def _without(stand: Stand, cut: Bool[Tensor, "b n"]) -> Stand:
    return Stand(**{**vars(stand), "standing": stand.standing & ~cut})
