"""Trees: crowns of leaves or needles, bare ones, trunks."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight.skies.surroundings.draws import Draws, Range
from skylight.skies.surroundings.layer import EYE_M, SNOW, Layer, Site
from skylight.skies.surroundings.light import spread
from skylight.skies.surroundings.stands import Crown, Stand, draw_stand, look

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
