"""Random search for the design that relights best under given lights."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from scipy.spatial import ConvexHull
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.partitions.design.designs import design_names, named_design
from skylight.probes.partitions.design.objective import RelightingError
from skylight.probes.partitions.seeds import ProbeDesign
from skylight.sphere.frame import direction_from_angles
from skylight.work.progress import Progress, StageProgress

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
