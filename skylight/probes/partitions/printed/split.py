"""Where a partition probe's shell is cut in two, so that the kernel can be put in.

The walls form a net of junctions; those above a plane through the centre belong to the upper half,
the others to the lower one, and a wall between an upper and a lower junction is cut squarely at
its middle. So no cut runs along a wall, and no edge is sharp.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from skylight.errors import InputError
from skylight.probes.partitions.printed.sizes import ProbeSizes
from skylight.probes.partitions.printed.solids import WallEnds, WallNet
from skylight.sphere.grid import DirectionGrid

_CANDIDATES = 500
_PIN_MM = 0.05  # gap that another pin is worth
_MOST_PINS, _LEAST_PINS = 4, 2
_UPRIGHT = 0.8  # least cosine between a pinned wall and the plane's normal
_APART_RAD = math.radians(50.0)  # of pins, about the centre


@dataclass(frozen=True, kw_only=True)
class Split:
    """``way_in`` (3,): the upper half comes off along it. ``upper`` (v,): which junctions are its.

    ``cut`` (e,): walls cut in the middle; ``pinned``: those of them that carry pins.
    """

    way_in: Float[np.ndarray, "3"]
    upper: Bool[np.ndarray, " v"]
    cut: Bool[np.ndarray, " e"]
    pinned: Int[np.ndarray, " p"]


def choose_split(
    ends: WallEnds,
    sizes: ProbeSizes,
    *,
    foot: Float[np.ndarray, "3"],
    foot_mm: float,
    pin_mm: float,
) -> Split:
    """Of many planes, the one whose halves leave the kernel the smallest gaps.

    Cut walls keep away from the foot (a unit direction; radius ``foot_mm``), and are long enough
    that the cut is clear of the junctions; two of them at least run straight enough through the
    plane to carry a pin ``pin_mm`` wide.
    """
    net = ends.net
    best: tuple[float, Split] | None = None
    for way_in in _candidates(net):
        split = _split(net, way_in if way_in @ foot < 0 else -way_in, sizes, pin_mm)
        if split is None or not _clear_of_foot(net, split, sizes, foot, foot_mm):
            continue
        cost = widest_gap_mm(ends, split) - _PIN_MM * len(split.pinned)
        if best is None or cost < best[0] - 1e-9:
            best = cost, split
        if best[0] < 1e-6 - _PIN_MM * _MOST_PINS:
            break  # no gap, and as many pins as wanted
    if best is None:
        raise InputError(
            "the shell cannot be cut in two between its junctions: cells are too small for their "
            "walls, or the pole is too thick; make kernel_mm and outer_mm larger, or walls and "
            "pole thinner"
        )
    return best[1]


def _candidates(net: WallNet) -> Float[np.ndarray, "c 3"]:
    """The net's own directions, which fit symmetric designs exactly, and even ones."""
    even = DirectionGrid.hammersley(_CANDIDATES).directions.numpy()
    every = np.concatenate([net.normals, net.middles, net.poles, net.vertices, even])
    # opposite directions make the same cut
    first = every[np.arange(len(every)), np.abs(every).argmax(1)] > 0
    every = np.where(first[:, None], every, -every)
    _, once = np.unique(every.round(6), axis=0, return_index=True)
    return every[np.sort(once)]


def _split(
    net: WallNet, way_in: Float[np.ndarray, "3"], sizes: ProbeSizes, pin_mm: float
) -> Split | None:
    height = net.vertices @ way_in
    if (np.abs(height[net.meeting > 0]) < 1e-6).any():
        return None
    upper = height > 0
    cut = upper[net.starts] != upper[net.ends]
    # at the kernel, where walls are shortest, both ends clear of the walls that leave at 60 degrees
    least = (1.75 * sizes.wall_mm + 2.5 * sizes.clearance_mm) / sizes.kernel_mm
    if not cut.any() or net.lengths_rad[cut].min() < least:
        return None
    if _pieces(net, ~cut) > 2:  # a half would fall apart
        return None
    pinned = _pins(net, np.flatnonzero(cut), way_in, sizes, pin_mm)
    if len(pinned) < _LEAST_PINS:
        return None
    return Split(way_in=way_in, upper=upper, cut=cut, pinned=pinned)


def _pieces(net: WallNet, kept: Bool[np.ndarray, " e"]) -> int:
    """Into how many pieces the net falls with these walls alone."""
    count = len(net.vertices)
    ends = (net.starts[kept], net.ends[kept])
    joined = coo_array((np.ones(len(ends[0])), ends), shape=(count, count))
    _, piece = connected_components(joined, directed=False)
    return len(np.unique(piece[net.meeting > 0]))


def _pins(
    net: WallNet,
    cut: Int[np.ndarray, " k"],
    way_in: Float[np.ndarray, "3"],
    sizes: ProbeSizes,
    pin_mm: float,
) -> Int[np.ndarray, " p"]:
    """Cut walls that run through the plane most steeply, far from one another."""
    tangent = np.cross(net.poles[cut], net.middles[cut])
    steep = np.abs(tangent @ way_in)
    room = net.lengths_rad[cut] * sizes.radius_mm > 2 * pin_mm
    chosen: list[int] = []
    for place in np.argsort(-steep.round(6), kind="stable").tolist():
        if steep[place] < _UPRIGHT or not room[place] or len(chosen) == _MOST_PINS:
            continue
        others = net.middles[cut[chosen]]
        if not chosen or (others @ net.middles[cut[place]]).max() < math.cos(_APART_RAD):
            chosen.append(place)
    return cut[chosen]


def _clear_of_foot(
    net: WallNet,
    split: Split,
    sizes: ProbeSizes,
    foot: Float[np.ndarray, "3"],
    foot_mm: float,
) -> bool:
    away = np.linalg.norm(sizes.radius_mm * (net.middles[split.cut] - foot), axis=1)
    below = (net.vertices @ foot > 1 - 1e-9) & split.upper
    return bool(away.min() > foot_mm + sizes.wall_mm) and not below.any()


def widest_gap_mm(ends: WallEnds, split: Split) -> float:
    """The largest gap, below the middles of walls, that the way in leaves above the kernel."""
    net = ends.net
    least = ends.lowest()[1]
    has_upper = split.upper[net.starts] | split.upper[net.ends]
    has_lower = ~(split.upper[net.starts] & split.upper[net.ends])
    above = ends.lowest(-split.way_in)[1] - least
    below = ends.lowest(split.way_in)[1] - least
    return float(max(above[has_upper].max(), below[has_lower].max()))
