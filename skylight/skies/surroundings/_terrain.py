"""Land and trees before a sky: mountains, hills and woods along the horizon, and stands of trees.

A tree is a crown of leaves or needles, or a bare one, on a trunk; a stand tells which crown and
which trunks each column of the map sees, and where.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.skies.surroundings._layer import (
    EYE_M,
    NOWHERE,
    SNOW,
    SUN_HIDDEN,
    Colour,
    Draws,
    Layer,
    Range,
    Site,
    spread,
)

FRINGE = 1.3  # how far leaves reach beyond a crown's ellipse, over its size
# Of whole crowns: about half of what a leaf reflects, the rest is lost between the leaves.
LEAVES = (
    (0.02, 0.03, 0.01),
    (0.035, 0.05, 0.015),
    (0.05, 0.075, 0.02),
    (0.07, 0.09, 0.03),
    (0.03, 0.035, 0.02),
    (0.09, 0.07, 0.03),  # autumn
)
BARK = ((0.12, 0.09, 0.065), (0.07, 0.055, 0.04), (0.2, 0.18, 0.15))
THROUGH = (0.7, 0.8, 0.35)  # what leaves let through, over what they reflect


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


@dataclass(frozen=True, kw_only=True)
class Trees:
    """``rows`` of up to ``count`` trees, each row in its part of the distances."""

    count: int
    distance_m: Range
    height_m: Range
    slender: Range = (0.25, 0.5)  # half the width of a crown over the height of the tree
    stem: Range = (0.1, 0.3)  # height below the crown over that of the tree
    rows: int = 1
    bare: float = 0.15  # share of scenes whose trees have no leaves
    needles: float = 0.3  # share of trees with pointed crowns

    def layers(self, draws: Draws, site: Site) -> Iterator[Layer]:
        """The farthest row first, trunks before crowns."""
        bare = draws.chance(self.bare, 1, 1)
        bark, species = draws.colour(BARK), draws.colour(LEAVES)[:, None]
        near, far = self.distance_m
        for row in range(self.rows):
            stand = draw_stand(
                draws,
                self.count,
                distance_m=tuple(far * (near / far) ** (k / self.rows) for k in (row + 1, row)),
                height_m=self.height_m,
                slender=self.slender,
                stem=self.stem,
                pointed=self.needles,
            )
            crown, stand = look(stand, draws, site)
            yield _trunks(stand, bark, draws, site)
            leaves = species * torch.exp(0.25 * draws.normal(self.count, 1))
            yield _crowns(crown, bare, bark, leaves, draws, site.up_to(crown.top))


def _trunks(stand: Stand, bark: Float[Tensor, "b 3"], draws: Draws, site: Site) -> Layer:
    """Upright strips into the crowns, tapering; some in the shade of others."""
    half = torch.where(stand.standing, stand.trunk_m / stand.distance_m, 0.0)
    strip, which = site.view.across(stand.azimuth, half).max(1)
    over = (0.7 * stand.height_m - EYE_M).clamp(min=0.01)
    top = torch.atan2(over, stand.distance_m).gather(1, which)
    site = site.up_to(float(top.max()))
    taper = (1 - 0.5 * site.view.elevation / top[:, None]).clamp(0.3, 1)
    away, _ = site.view.frame
    sunny = draws.chance(0.5, len(half[0])).float().gather(1, which)[..., None]
    facing = -away.expand(len(top), -1, -1)
    received = site.light.irradiance(facing, 0.5 * site.open[:, None, None], sunny)
    radiance = (spread(bark, received) / math.pi * received)[:, None]
    return Layer(
        cover=strip[:, None] * taper * site.view.between(torch.zeros_like(top), top),
        radiance=radiance.expand(-1, site.view.rows, -1, -1),
        distance_m=stand.distance_m.gather(1, which),
    )


def _crowns(
    crown: Crown,
    bare: Bool[Tensor, "b 1 1"],
    bark: Float[Tensor, "b 3"],
    leaves: Float[Tensor, "b n 3"],
    draws: Draws,
    site: Site,
) -> Layer:
    rough, fine = site.view.texture(draws, 0.9), site.view.texture(draws, 0.4)
    dense = draws.scale((0.8, 4.0), 1, 1)
    solid = draws.uniform((0.88, 1.0), 1, 1)  # between the leaves there is sky
    leafy = dense * (1 - crown.within.square()) + 0.7 * rough + 0.5 * fine
    # lines where noise is near zero branch and join as twigs do
    twigs = (1 - 1.8 * fine.abs() / (1.2 - crown.within).clamp(min=0.2)).clamp(0, 1)
    limbs = (1 - 3 * rough.abs() * (0.3 + crown.within)).clamp(0, 1)
    twigs = torch.maximum(0.6 * twigs, limbs) * (crown.within < 1.1)
    shown = torch.where(bare, twigs, solid * (0.6 + leafy).clamp(0, 1))
    colour = leaves.gather(1, crown.tree[..., None].expand(-1, -1, 3))
    return Layer(
        cover=crown.reach * shown,
        radiance=_leaf_light(crown, bare, bark, colour[:, None], (rough, fine), site),
        distance_m=crown.distance_m,
    )


def _leaf_light(
    crown: Crown,
    bare: Bool[Tensor, "b 1 1"],
    bark: Float[Tensor, "b 3"],
    leaves: Float[Tensor, "b 1 c 3"],
    noise: tuple[Float[Tensor, "b h c"], Float[Tensor, "b h c"]],
    site: Site,
) -> Float[Tensor, "b h c 3"]:
    """Radiance of crowns that reflect ``leaves`` E(n) and let through ``THROUGH`` of E(-n).

    Clumps of leaves face all ways about the crown's own normal. ``outer`` is how much of the
    light reaches them through others: little inside and below.
    """
    rough, fine = noise
    away, right = site.view.frame
    across = (crown.across[:, None] + 0.5 * fine)[..., None]
    up = (0.8 * crown.up + 0.4 * rough + 0.2)[..., None]
    normal = across * right + up * away.new_tensor([0.0, 1.0, 0.0]) - 0.6 * away
    normal = normal / normal.norm(dim=-1, keepdim=True)
    outer = torch.sigmoid(2 * crown.up + 1.5 * crown.within + 2.5 * fine - 1.5)[..., None]
    free = site.open[:, None, None, None]
    lit = outer * (0.3 + 0.7 * free)
    received = site.light.irradiance(normal, (0.03 + 0.97 * outer) * free, lit)
    behind = site.light.towards_sun(-normal).clamp(min=0) * spread(site.light.beam, normal)
    behind = 0.5 * lit * (behind + site.light.diffuse(-normal))
    white = site.snow[:, None, None] * (0.5 + 1.5 * fine + 0.5 * crown.up).clamp(0, 0.8)
    white = white[..., None]
    reflected = (leaves + (SNOW - leaves) * white) * received
    through = leaves * leaves.new_tensor(THROUGH) * behind * (1 - white)
    twigs = spread(bark, received) * received
    return torch.where(bare[..., None], twigs, reflected + through) / math.pi
