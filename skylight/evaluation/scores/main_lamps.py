"""The lamps of a map: where over the whole sphere light is concentrated, and how much of it.

Lamps are peeled off one after the other. With luminance L, its median m over solid angle and the
excess ``e(w) = max(L(w) - m, 0)``, the next lamp is the cap of 15 degrees with the most excess
that is left; it is centred on the centroid of what is in it (mean shift), which is the lamp's
direction, and taken away. Its share is ::

    int_cap e dw / int_sphere L dw.

Lamps less than 30 degrees apart may count as one, and a wide window as several.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice, takewhile

from jaxtyping import Float
from torch import Tensor

from skylight.sphere.envmap import EnvironmentMap, luminance
from skylight.sphere.grid import DirectionGrid

CAP_RAD = math.radians(15)
MOST = 6
LEAST_SHARE = 0.05
ROWS = 64  # of the map that is looked at
_CENTRE_ROWS = 32  # of the caps that are tried: 5.6 degrees apart, before they are centred
_SHIFTS = 10


@dataclass(frozen=True, kw_only=True)
class MapLamp:
    """``direction`` is a unit vector (float64), ``share`` the part of all light beyond the rest's.

    All light is the integral of luminance over the sphere.
    """

    direction: Float[Tensor, "3"]
    share: float


def find_lamps(
    environment: EnvironmentMap, *, most: int = MOST, least_share: float = LEAST_SHARE
) -> list[MapLamp]:
    """At most so many lamps of a full map, of more than ``least_share`` each, largest first.

    None for constant light and for a black map.
    """
    light = environment if environment.layout[0] == ROWS else environment.resize(ROWS)
    grid = light.grid
    level = luminance(light.flat).double()
    total = float(level @ grid.solid_angles)
    if total <= 0:
        return []
    excess = (level - _median(level, grid.solid_angles)).clamp(min=0) * grid.solid_angles
    lamps = islice(_peeled(excess / total, grid), most)
    chosen = takewhile(lambda lamp: lamp.share > least_share, lamps)
    return sorted(chosen, key=lambda lamp: -lamp.share)


def _peeled(excess: Float[Tensor, " n"], grid: DirectionGrid) -> Iterator[MapLamp]:
    """One lamp after the other, until there is no excess."""
    while bool(excess.any()):
        centre = _centres().directions[(_caps() @ excess.float()).argmax()]
        for _ in range(_SHIFTS):
            cap = (grid.directions @ centre) > math.cos(CAP_RAD)
            centroid = (excess * cap) @ grid.directions
            centre = centroid / centroid.norm()
        cap = (grid.directions @ centre) > math.cos(CAP_RAD)
        yield MapLamp(direction=centre, share=float(excess[cap].sum()))
        excess = excess.where(~cap, 0.0)


def _median(level: Float[Tensor, " n"], weights: Float[Tensor, " n"]) -> Float[Tensor, ""]:
    order = level.argsort()
    below = weights[order].cumsum(0)
    return level[order[int((below < below[-1] / 2).sum())]]


def _centres() -> DirectionGrid:
    return DirectionGrid.latlong(_CENTRE_ROWS)


@lru_cache(maxsize=1)
def _caps() -> Float[Tensor, "c n"]:
    """1 where a pixel lies within the cap about a centre: 2048 x 8192 float32, 67 MB."""
    cosine = _centres().directions.float() @ DirectionGrid.latlong(ROWS).directions.float().T
    return (cosine > math.cos(CAP_RAD)).float()
