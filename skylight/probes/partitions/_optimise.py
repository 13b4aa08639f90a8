"""Named designs, and random search for the one that relights best under given lights.

What is searched for is the least error of relighting a test scene, over many lights at once; lights
that are held out measure what the search has gained. The named designs are those of the thesis
(Fig. 4.3 and 4.4), read off its figures:

==================  ===========================================================================
6d 14d 38d 110d     the points of Lebedev quadrature of degrees 3, 5, 9 and 17: near-uniform
14d-indoor          14 cells, small above and large below
14d-outdoor         a path of 7 cells through the zenith, with the 6 around it of which one is cut
6d-sun-6, ...       6 or 14 base cells with 6 or 12 along a path from +X through the zenith to -X
6d-tilted-sun-12    the same with a path that leans by 30 degrees towards +Z
==================  ===========================================================================

Where a path runs through a base cell, that one is cut in two. In the world of
:func:`~skylight.probes.partitions._sun_path.sun_path`, +X is east and +Z south.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Float, Int
from scipy.integrate import lebedev_rule
from scipy.spatial import ConvexHull
from torch import Tensor

from skylight._modes import on_cpu
from skylight.errors import InputError
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._seeds import ProbeDesign
from skylight.probes.partitions._sun_path import MAP_HEIGHT, Lights, path_design, path_through
from skylight.sphere._envmap import luminance, shift_columns
from skylight.sphere._frame import DirectionGrid, cosines, direction_from_angles
from skylight.transport._scene import evaluation_scene
from skylight.work._progress import Progress, StageProgress


class RelightingError:
    """Mean over lights of a scene's relative MAE under direct light: ``|T (L - L^)| / mean T L``.

    L^ is constant in each cell (thesis, Eq. 4.5)::

        L^_i = int_cell_i <n_i, w> L dw / int_cell_i <n_i, w> dw

    transport : (m,d), of m points of the scene and the d directions of ``grid``, with albedo,
        shadows and solid angles.
    lights : (b,d,c) radiance, c colours. Scaled here so that each makes a mean shading of 1, so
        that bright and dim lights count the same.
    """

    def __init__(
        self,
        transport: Float[Tensor, "m d"],
        lights: Float[Tensor, "b d c"],
        grid: DirectionGrid,
    ) -> None:
        rows = transport.mean(0).double()
        # float64 sums: a lamp is 1e5 times brighter than what it is added to
        mean = torch.stack([(rows @ light.double()).mean() for light in lights])
        if not bool((mean > 0).all()):
            raise InputError(f"light {int(mean.argmin())} leaves the scene black: take it out")
        scaled = lights.double() / mean[:, None, None]
        self._lights = scaled.permute(1, 0, 2).flatten(1).float().contiguous()
        # most directions below the ground light nothing
        self._lit = torch.nonzero(transport.any(0))[:, 0]
        self._columns = transport.T[self._lit].float().contiguous()
        self._true = transport.float() @ self._lights
        self._directions = grid.directions.float()
        self._solid_angles = grid.solid_angles.float()

    def of_seeds(self, seeds: Float[Tensor, "n 3"]) -> float:
        """Of a design in which each unit seed is a cell; infinite where one holds no direction."""
        seeds = seeds.float()
        return self._of(seeds, cosines(self._directions, seeds).argmax(1))

    def of_cells(self, cells: Cells) -> float:
        """Of any design."""
        return self._of(cells.normals.float(), cells.cell_of(self._directions))

    def relaxed(
        self, seeds: Float[Tensor, "n 3"], sharpness: float | Float[Tensor, ""]
    ) -> Float[Tensor, ""]:
        """:meth:`of_seeds` with cells that blend into each other, differentiable in the seeds.

        Direction w belongs to cell i by the share ``softmax_i(sharpness <w, x_i>)``, which tends
        to the closest seed x_i as the sharpness grows.
        """
        seeds = seeds.float()
        near = cosines(self._directions, seeds)
        member = torch.softmax(sharpness * near, dim=1)
        cosine = member * near.clamp(min=0) * self._solid_angles[:, None]
        mean = (cosine / cosine.sum(0)).T @ self._lights
        shading = self._columns.T @ (member[self._lit] @ mean)
        return (shading - self._true).abs().mean()

    def _of(self, normals: Float[Tensor, "n 3"], cell: Int[Tensor, " d"]) -> float:
        cosine = (normals[cell] * self._directions).sum(1) * self._solid_angles
        total = cosine.new_zeros(len(normals)).index_add_(0, cell, cosine)
        if not bool((total > 0).all()):
            return math.inf
        share = cosine.new_zeros(len(normals), len(cell))
        share[cell, torch.arange(len(cell))] = cosine / total[cell]
        transfer = cosine.new_zeros(len(normals), self._columns.shape[1])
        transfer.index_add_(0, cell[self._lit], self._columns)
        shading = transfer.T @ (share @ self._lights)
        return float(shading.sub_(self._true).abs_().mean())


def turned_about_vertical(
    maps: Float[Tensor, "k h w c"], turns: int, generator: torch.Generator
) -> Float[Tensor, "b d c"]:
    """Each map turned ``turns`` times, evenly from a random start; b = k turns, d = h w."""
    start = torch.rand(len(maps), 1, generator=generator)
    angle = (start + torch.arange(turns)) * (2 * math.pi / turns)
    return shift_columns(maps.repeat_interleave(turns, 0), angle.flatten()).flatten(1, 2)


_LEBEDEV_DEGREE = {6: 3, 14: 5, 38: 9, 110: 17}
_TILT_RAD = math.radians(30.0)
# zenith angle in degrees, seeds, and azimuth of the first in degrees
_INDOOR_RINGS = ((0.0, 1, 0.0), (40.0, 4, 45.0), (78.0, 6, 0.0), (135.0, 3, 0.0))


def design_names() -> list[str]:
    """What :func:`named_design` knows."""
    return list(_DESIGNS)


@on_cpu
def named_design(name: str) -> ProbeDesign:
    """The design of that name."""
    if name not in _DESIGNS:
        raise InputError(f"no design is called {name!r}: choose one of {', '.join(_DESIGNS)}")
    return _DESIGNS[name](name)


def _even(name: str, *, cells: int) -> ProbeDesign:
    points, _ = lebedev_rule(_LEBEDEV_DEGREE[cells])
    return ProbeDesign.of(name, torch.from_numpy(points.T.copy()))


def _indoor(name: str) -> ProbeDesign:
    rings = [_ring(*ring) for ring in _INDOOR_RINGS]
    return ProbeDesign.of(name, torch.cat(rings))


def _ring(zenith_deg: float, count: int, first_deg: float) -> Float[Tensor, "k 3"]:
    azimuth = torch.arange(count, dtype=torch.float64) * (2 * math.pi / count)
    zenith = torch.full_like(azimuth, math.radians(zenith_deg))
    return direction_from_angles(azimuth + math.radians(first_deg), zenith)


def _sun(name: str, *, base: int, cells: int, tilt_rad: float = 0.0) -> ProbeDesign:
    east = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    noon = torch.tensor([0.0, math.cos(tilt_rad), math.sin(tilt_rad)], dtype=torch.float64)
    return path_design(name, _even(name, cells=base), cells, path_through(east, noon, -east))


_DESIGNS = {
    **{f"{n}d": partial(_even, cells=n) for n in _LEBEDEV_DEGREE},
    "14d-indoor": _indoor,
    "14d-outdoor": partial(_sun, base=6, cells=7),
    "6d-sun-6": partial(_sun, base=6, cells=6),
    "6d-sun-12": partial(_sun, base=6, cells=12),
    "6d-tilted-sun-12": partial(_sun, base=6, cells=12, tilt_rad=_TILT_RAD),
    "14d-sun-6": partial(_sun, base=14, cells=6),
    "14d-sun-12": partial(_sun, base=14, cells=12),
    "14d-tilted-sun-12": partial(_sun, base=14, cells=12, tilt_rad=_TILT_RAD),
}


FEWEST_CELLS, MOST_CELLS = 6, 110
_FIRST_STEP_RAD, _LAST_STEP_RAD = 0.5, 0.03
_MOST_REACH_RAD = math.radians(85.0)
_BELOW, _BELOW_ZENITH_RAD = 3, math.radians(125.0)
_GOLDEN_TURN = math.pi * (3 - math.sqrt(5))
_REPORT_EVERY = 50


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """``starts`` searches of ``steps`` trials each.

    What is found can be printed. Seeds stay ``width_rad`` apart, so that every cell holds a cone
    of that opening about its face's normal; by default half of what even cells would have. No
    part of a cell is further than ``reach_rad`` from its seed, since the kernel's corners stick
    out by ``kernel_mm / cos(reach)``.
    """

    starts: int = 4
    steps: int = 4000
    width_rad: float | None = None
    reach_rad: float = math.radians(65.0)

    def __post_init__(self) -> None:
        if self.starts < 1 or self.steps < 1:
            raise InputError(
                f"the search needs 1 start and 1 step or more, got {self.starts}, {self.steps}"
            )
        if self.width_rad is not None and not 0 < self.width_rad < math.pi / 2:
            raise InputError(
                f"cells must be more than 0 and less than 90 degrees wide, got "
                f"{math.degrees(self.width_rad):g}"
            )
        if not 0 < self.reach_rad <= _MOST_REACH_RAD:
            raise InputError(
                f"cells must reach more than 0 and at most {math.degrees(_MOST_REACH_RAD):g} "
                f"degrees from their seeds, got {math.degrees(self.reach_rad):g}"
            )

    def width(self, count: int) -> float:
        return math.sqrt(math.pi / count) if self.width_rad is None else self.width_rad


def symmetric_design(count: int) -> ProbeDesign:
    """The baseline of equal cells: Lebedev's points, or a Fibonacci lattice for other counts."""
    _check_count(count)
    name = f"{count}d"
    if name in design_names():
        return named_design(name)
    return ProbeDesign.of(f"even-{count}", _fibonacci(count, 1.0, -1.0))


def optimise_design(
    name: str,
    count: int,
    error: RelightingError,
    generator: torch.Generator,
    *,
    settings: SearchSettings | None = None,
    oriented: bool = False,
    progress: StageProgress = lambda _stage, _share: None,
) -> ProbeDesign:
    """The best of several random local searches over ``count`` seeds.

    A trial moves one seed by a random step and is accepted if the error falls and the design can
    be printed. Unless ``oriented``, all seeds are then rotated so that the lowest corner of cells,
    at which the pole holds a printed probe, points straight down. Steps shrink from 30 degrees to
    2. Searches start from even designs and from ones with most cells in the upper hemisphere,
    which lights a scene on the ground.
    """
    settings = settings or SearchSettings()
    _check_count(count)
    printing = _Print(
        width_rad=settings.width(count), reach_rad=settings.reach_rad, on_pole=not oriented
    )
    found: list[tuple[float, Tensor]] = []
    for number in range(settings.starts):

        def tell(share: float, number: int = number) -> None:
            stage = f"search {number + 1} of {settings.starts}"
            progress(stage, (number + share) / settings.starts)

        start = _start(count, number % 2 == 0, printing, generator)
        found.append(_search(start, error, settings.steps, printing, generator, tell))
    best = min(found, key=lambda pair: pair[0])[1]
    return ProbeDesign.of(name, best, oriented=oriented)


@dataclass(frozen=True, kw_only=True)
class _Print:
    """Which designs can be printed; those ``on_pole`` may be rotated."""

    width_rad: float
    reach_rad: float
    on_pole: bool

    def posed(self, seeds: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"] | None:
        """Seeds in the pose of the printed probe; None where it cannot be printed.

        The pole holds it at the lowest corner where cells meet. Such corners are the normals of
        the facets of the seeds' hull, whose distances from the origin are the cosines of their
        angles to their seeds.
        """
        if float((seeds @ seeds.T).fill_diagonal_(-1).max()) > math.cos(self.width_rad):
            return None
        facets = torch.from_numpy(ConvexHull(seeds.numpy()).equations)
        if float(-facets[:, 3].max()) < math.cos(self.reach_rad):
            return None
        if not self.on_pole:
            return seeds
        lowest = facets[facets[:, 1].argmin(), :3]
        turn = _smallest_turn(lowest, torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64))
        return seeds @ turn.T


def _search(
    seeds: Float[Tensor, "n 3"],
    error: RelightingError,
    steps: int,
    printing: _Print,
    generator: torch.Generator,
    tell: Progress,
) -> tuple[float, Float[Tensor, "n 3"]]:
    lowest = error.of_seeds(seeds)
    for step in range(steps):
        if step % _REPORT_EVERY == 0:
            tell(step / steps)
        size = _FIRST_STEP_RAD * (_LAST_STEP_RAD / _FIRST_STEP_RAD) ** (step / steps)
        moved = int(torch.randint(len(seeds), (1,), generator=generator))
        trial = seeds.clone()
        trial[moved] += size * torch.randn(3, generator=generator, dtype=torch.float64)
        trial[moved] /= trial[moved].norm()
        trial = printing.posed(trial)
        if trial is not None and (reached := error.of_seeds(trial)) < lowest:
            lowest, seeds = reached, trial
    return lowest, seeds


def _start(
    count: int, upwards: bool, printing: _Print, generator: torch.Generator
) -> Float[Tensor, "n 3"]:
    """The even design under a random rotation, or most cells above where they can be printed."""
    if upwards:
        above = _fibonacci(count - _BELOW, 1.0, 0.0)
        azimuth = torch.arange(_BELOW, dtype=torch.float64) * (2 * math.pi / _BELOW)
        azimuth += 2 * math.pi * torch.rand(1, generator=generator, dtype=torch.float64)
        below = direction_from_angles(azimuth, torch.full_like(azimuth, _BELOW_ZENITH_RAD))
        seeds = printing.posed(torch.cat([above, below]))
        if seeds is not None:
            return seeds
    seeds = printing.posed(symmetric_design(count).seeds @ _random_rotation(generator))
    if seeds is None:
        raise InputError(
            f"{count} cells {math.degrees(printing.width_rad):.1f} degrees wide that reach no "
            f"further than {math.degrees(printing.reach_rad):.0f} leave no room to search: make "
            f"them narrower, such as {math.degrees(SearchSettings().width(count)):.0f}, or let "
            "them reach further"
        )
    return seeds


def _fibonacci(count: int, top: float, bottom: float) -> Float[Tensor, "n 3"]:
    """A Fibonacci lattice between two heights: equal areas along a spiral of the golden angle."""
    index = torch.arange(count, dtype=torch.float64)
    height = top + (bottom - top) * (index + 0.5) / count
    return direction_from_angles(index * _GOLDEN_TURN, torch.acos(height))


def _random_rotation(generator: torch.Generator) -> Float[Tensor, "3 3"]:
    """Haar distributed over O(3): the Q of a Gaussian matrix, signs fixed by R."""
    q, r = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))
    return q * r.diagonal().sign()


def _smallest_turn(start: Float[Tensor, "3"], end: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """R with R start = end, unit and not opposite: 1 + K + K^2 / (1 + <start, end>)."""
    outer = end[:, None] * start
    across = outer - outer.T  # across @ x = (start x end) x x
    return torch.eye(3, dtype=start.dtype) + across + across @ across / (1 + start @ end)


def _check_count(count: int) -> None:
    if not FEWEST_CELLS <= count <= MOST_CELLS:
        raise InputError(f"designs have {FEWEST_CELLS} to {MOST_CELLS} cells, got {count}")


_SCENE_HEIGHT = 20  # pixels: 390 points, a third of them on objects and in their shadows
_LIGHTS = 288  # that the search sees at least, maps times their turns


@dataclass(frozen=True, kw_only=True)
class Score:
    """MAE of relit shading over its mean, on the lights searched on and on the others."""

    training: float
    held_out: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Optimised:
    """A design, the scores of it and of others by name, and the lights of both sets.

    ``scores`` begin with the symmetric design and end with this one.
    """

    design: ProbeDesign
    scores: dict[str, Score]
    training: tuple[str, ...]
    held_out: tuple[str, ...]

    @property
    def gain(self) -> float:
        """Share of the symmetric design's held-out error that this one saves."""
        held = [score.held_out for score in self.scores.values()]
        return 1 - held[-1] / held[0]


def optimise_for(
    lights: Lights,
    name: str,
    count: int,
    *,
    held_out: float = 0.5,
    seed: int = 0,
    settings: SearchSettings | None = None,
    rivals: Sequence[ProbeDesign] = (),
    tell: StageProgress = lambda _stage, _share: None,
) -> Optimised:
    """Search on a training set of the lights, and compare with other designs on the test set.

    The test set is a share ``held_out``, drawn at random. The search uses luminance, the scores
    all colours.
    """
    others = (symmetric_design(count), *rivals)
    if name in [other.name for other in others]:
        raise InputError(f"there is a design {name!r} already: choose another name")
    generator = torch.Generator().manual_seed(seed)
    training, test = _divide(lights.groups, held_out, generator)
    scene = evaluation_scene(_SCENE_HEIGHT, MAP_HEIGHT)
    transport = scene.albedo[:, :1] * scene.transport.matrix

    def error_on(which: Sequence[int], *, coloured: bool = True) -> RelightingError:
        maps = lights.maps[list(which)]
        if not coloured:
            maps = luminance(maps)[..., None]
        turns = 1 if lights.oriented else max(1, math.ceil(_LIGHTS / len(which)))
        # from equal generators, so that grey and coloured lights are turned alike
        same = torch.Generator().manual_seed(seed)
        turned = turned_about_vertical(maps, turns, same) if turns > 1 else maps.flatten(1, 2)
        return RelightingError(transport, turned, scene.grid)

    design = optimise_design(
        name,
        count,
        error_on(training, coloured=False),
        generator,
        settings=settings,
        oriented=lights.oriented,
        progress=tell,
    )
    on_training, on_test = error_on(training), error_on(test)
    scores = {}
    for each in (*others, design):
        cells = Cells.of(each)
        scores[each.name] = Score(
            training=on_training.of_cells(cells), held_out=on_test.of_cells(cells)
        )
    return Optimised(
        design=design,
        scores=scores,
        training=tuple(lights.names[i] for i in training),
        held_out=tuple(lights.names[i] for i in test),
    )


def _divide(
    groups: Sequence[int], held_out: float, generator: torch.Generator
) -> tuple[list[int], list[int]]:
    """Places of the lights to search on, and of the others; groups stay whole."""
    known = sorted(set(groups))
    if not 0 < held_out < 1:
        raise InputError(f"the share held out must be between 0 and 1, got {held_out:g}")
    if len(known) < 2:
        raise InputError(
            "one map or weather is too few: give one to search on and one to test with"
        )
    order = torch.randperm(len(known), generator=generator).tolist()
    kept_back = min(max(1, round(held_out * len(known))), len(known) - 1)
    test = {known[i] for i in order[:kept_back]}
    places = range(len(groups))
    return [i for i in places if groups[i] not in test], [i for i in places if groups[i] in test]
