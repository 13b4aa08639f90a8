"""The printed parts of a partition probe: two half shells with pins, kernel, and the pole's socket.

Parts stand as assembled: origin in the probe's centre, +Y up, mm. The shell is cut in two, so that
the kernel can be put in. The walls form a net of junctions; those above a plane through the centre
belong to the upper half, the others to the lower one, and a wall between an upper and a lower
junction is cut squarely at its middle. So no cut runs along a wall, and no edge is sharp.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from skylight.errors import InputError
from skylight.probes.fabrication._parts import PrintedPart, part_of
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions.printed._solids import (
    ProbeSizes,
    WallEnds,
    WallNet,
    along_axis,
    bend_solids,
    core_solid,
    corners_of,
    kernel_solid,
    rim_halves,
    wall_solid,
)
from skylight.sphere._frame import DirectionGrid

if TYPE_CHECKING:
    from manifold3d import Manifold

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


_SEGMENTS = 48
_SPECK_MM3 = 1e-3
_DOWN = np.array([0.0, -1.0, 0.0])
_STEEPEST_FOOT_COS = 0.5  # the pole's joint lies within 60 degrees of straight down
_JOINT_MM = 6.0  # depth to which the pole's socket holds the walls
_PIN_WALLS, _PIN_LENGTHS = 1.25, 2.0  # a pin's width in walls, and its length in widths


@dataclass(frozen=True, kw_only=True)
class Foot:
    """The socket of a vertical pole below the joint of walls in direction ``joint``; mm.

    The pole's axis passes (x, z) and its upper end stops at ``top_mm``.
    """

    joint: Float[np.ndarray, "3"]
    axis: tuple[float, float]
    radius_mm: float
    bore_mm: float
    top_mm: float
    bottom_mm: float

    @staticmethod
    def of(net: WallNet, sizes: ProbeSizes, pole_mm: float) -> "Foot":
        """Below the lowest junction of three walls or more."""
        joint = net.vertices[lowest_junction(net)]
        if joint[1] > -_STEEPEST_FOOT_COS:
            raise InputError(
                "walls meet nowhere near below the probe, where its pole would hold it: turn the "
                "design, or add seeds below"
            )
        bore = pole_mm / 2 + sizes.clearance_mm
        radius = bore + sizes.wall_mm
        x, _, z = (sizes.radius_mm * joint).tolist()
        near = max(math.hypot(x, z) - radius, 0.0)  # below the ball all over the socket
        top = -math.sqrt(sizes.radius_mm**2 - near**2)
        return Foot(
            joint=joint,
            axis=(x, z),
            radius_mm=radius,
            bore_mm=bore,
            top_mm=top,
            bottom_mm=top - 2 * pole_mm,
        )


@dataclass(frozen=True, kw_only=True)
class ProbeParts:
    """Half shells and kernel, where they come apart, and where the pole goes."""

    net: WallNet
    rotation: Float[np.ndarray, "3 3"]
    lower: PrintedPart
    upper: PrintedPart
    kernel: PrintedPart
    split: Split
    foot: Foot

    @property
    def parts(self) -> tuple[PrintedPart, ...]:
        """In order of assembly."""
        return self.lower, self.kernel, self.upper


@dataclass(frozen=True, kw_only=True)
class ShellPlan:
    """What is decided of a probe before its solids are made: whether its sizes fit the design."""

    rims: Float[np.ndarray, "e 2"]
    kernel: "Manifold"
    ends: WallEnds
    foot: Foot
    split: Split

    @staticmethod
    def of(net: WallNet, sizes: ProbeSizes, pole_mm: float) -> "ShellPlan":
        """Raises :class:`InputError` where the sizes do not fit the design."""
        rims = rim_halves(net, sizes)
        kernel = kernel_solid(net, sizes)
        ends = WallEnds.of(net, corners_of(kernel))
        foot = Foot.of(net, sizes, pole_mm)
        boss = _boss_mm(sizes)
        split = choose_split(
            ends, sizes, foot=foot.joint, foot_mm=foot.radius_mm + boss, pin_mm=2 * boss
        )
        return ShellPlan(rims=rims, kernel=kernel, ends=ends, foot=foot, split=split)


def standing_rotation(cells: Cells) -> Float[np.ndarray, "3 3"]:
    """The smallest rotation that brings the lowest junction of walls straight down.

    The identity for oriented designs.
    """
    if cells.design.oriented:
        return np.eye(3)
    net = WallNet.of(cells)
    lowest = net.vertices[lowest_junction(net)]
    axis, cosine = np.cross(lowest, _DOWN), float(lowest @ _DOWN)
    cross = np.cross(np.eye(3), axis).T  # cross @ x = axis x x, up to its sign
    return np.eye(3) - cross + cross @ cross / (1 + cosine)


def lowest_junction(net: WallNet) -> int:
    """The lowest vertex where three walls or more meet."""
    height = np.where(net.meeting >= 3, net.vertices[:, 1], np.inf)
    return int(height.round(9).argmin())


def probe_parts(
    cells: Cells,
    sizes: ProbeSizes,
    *,
    rotation: Float[np.ndarray, "3 3"],
    pole_mm: float,
) -> ProbeParts:
    """Half shells and kernel of a design that stands turned by ``rotation``.

    Refuses sizes that do not fit: cells too narrow, kernel too large, nowhere to cut.
    """
    net = WallNet.of(cells, rotation)
    plan = ShellPlan.of(net, sizes, pole_mm)
    ends, split, foot, rims = plan.ends, plan.split, plan.foot, plan.rims
    lower, upper = (_half(ends, split, rims, sizes, upper=flag) for flag in (False, True))
    for wall in split.pinned.tolist():
        joint = _PinJoint(
            axis=split.way_in,
            place=sizes.radius_mm * net.middles[wall],
            pole=net.poles[wall],
            width=_PIN_WALLS * sizes.wall_mm,
            radius=_boss_mm(sizes),
            clear_mm=max(_boss_mm(sizes), float(rims[wall].max())) + sizes.wall_mm,
            sizes=sizes,
        )
        lower = lower + joint.boss(-1) - joint.keep_clear(1) + joint.pin()
        upper = upper + joint.boss(1) - joint.keep_clear(-1) - joint.hole()
    lower = _with_socket(lower, foot, sizes)
    return ProbeParts(
        net=net,
        rotation=rotation,
        lower=part_of("shell_lower", _without_specks(lower), (0, 1, 0)),
        upper=part_of("shell_upper", _without_specks(upper), (0, 1, 0)),
        kernel=part_of("kernel", plan.kernel, (0, 1, 0)),
        split=split,
        foot=foot,
    )


def _half(
    ends: WallEnds,
    split: Split,
    rims: Float[np.ndarray, "e 2"],
    sizes: ProbeSizes,
    *,
    upper: bool,
) -> "Manifold":
    from manifold3d import Manifold, OpType

    net = ends.net
    own = split.upper == upper
    walls = []
    for wall, pair in enumerate(net.ends_of_walls):
        mine = own[[net.starts[wall], net.ends[wall]]]
        if not mine.any():
            continue
        solid = wall_solid(pair, net.poles[wall], rims[wall], sizes)
        if split.cut[wall]:
            keep = np.cross(net.poles[wall], net.middles[wall])  # towards the wall's end
            keep = keep if mine[1] else -keep
            solid = solid.trim_by_plane(tuple(keep.tolist()), sizes.clearance_mm / 2)
        walls.append(solid)
    walls += bend_solids(net, np.flatnonzero(own).tolist(), rims, sizes)
    way = -split.way_in if upper else split.way_in
    return Manifold.batch_boolean(walls, OpType.Add) - core_solid(ends, sizes.clearance_mm, way)


def _boss_mm(sizes: ProbeSizes) -> float:
    """Radius of what holds a pin."""
    return _PIN_WALLS * sizes.wall_mm / 2 + sizes.clearance_mm + sizes.wall_mm


@dataclass(frozen=True, kw_only=True)
class _PinJoint:
    """A boss on either side of the cut at ``place``, a pin on the lower, its hole in the upper.

    Bosses are kept clear as far as ``clear_mm`` from the wall's plane, of unit normal ``pole``: so
    far that nothing thin is left of the other half beside them.
    """

    axis: Float[np.ndarray, "3"]
    place: Float[np.ndarray, "3"]
    pole: Float[np.ndarray, "3"]
    width: float
    radius: float
    clear_mm: float
    sizes: ProbeSizes

    @property
    def length(self) -> float:
        return _PIN_LENGTHS * self.width

    def boss(self, side: int) -> "Manifold":
        """Above (1) or below (-1) the cut."""
        gap = self.sizes.clearance_mm / 2
        height = self.length + self.sizes.clearance_mm + self.sizes.wall_mm
        return self._rod(self.radius, *sorted((side * gap, side * (gap + height))))

    def keep_clear(self, side: int) -> "Manifold":
        """What the other half must leave to that boss."""
        from manifold3d import Manifold

        gap, height = self.sizes.clearance_mm, self.length + 3 * self.sizes.wall_mm
        low, high = sorted((-side * gap / 2, side * height))
        across = np.cross(self.pole, self.axis)
        across /= np.linalg.norm(across)
        turn = np.stack([across, np.cross(self.axis, across), self.axis], 1)
        reach = self.radius / math.cos(math.pi / _SEGMENTS) + gap
        size = (2 * reach, 2 * self.clear_mm, high - low)
        block = Manifold.cube(size, True).translate((0.0, 0.0, (low + high) / 2))
        return block.transform(np.concatenate([turn, self.place[:, None]], 1))

    def pin(self) -> "Manifold":
        gap = self.sizes.clearance_mm / 2
        return self._rod(self.width / 2, -gap - self.sizes.wall_mm, self.length - gap)

    def hole(self) -> "Manifold":
        clear = self.sizes.clearance_mm
        return self._rod(self.width / 2 + clear, -2 * clear, self.length + clear / 2)

    def _rod(self, radius: float, low: float, high: float) -> "Manifold":
        from manifold3d import Manifold

        outer = radius / math.cos(math.pi / _SEGMENTS)  # nothing is narrower than the circle
        rod = Manifold.cylinder(high - low, outer, outer, _SEGMENTS).translate((0.0, 0.0, low))
        return along_axis(rod, self.axis).translate(tuple(self.place.tolist()))


def _with_socket(lower: "Manifold", foot: Foot, sizes: ProbeSizes) -> "Manifold":
    """A cylinder round the pole's upper end that holds the walls above it."""
    high = float(sizes.radius_mm * foot.joint[1]) + _JOINT_MM
    holder = _upright(foot, foot.radius_mm, foot.bottom_mm, high)
    bore = _upright(foot, foot.bore_mm, foot.bottom_mm - 1.0, foot.top_mm)
    return lower + holder - bore


def _without_specks(solid: "Manifold") -> "Manifold":
    """Booleans of surfaces that nearly meet leave pieces without a volume."""
    from manifold3d import Manifold

    pieces = solid.decompose()
    return Manifold.compose([piece for piece in pieces if piece.volume() > _SPECK_MM3])


def _upright(foot: Foot, radius: float, low: float, high: float) -> "Manifold":
    from manifold3d import Manifold

    outer = radius / math.cos(math.pi / _SEGMENTS)
    rod = Manifold.cylinder(high - low, outer, outer, _SEGMENTS).rotate((-90, 0, 0))
    return rod.translate((foot.axis[0], low, foot.axis[1]))
