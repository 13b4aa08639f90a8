"""Codes that are planted in a map, and whether the pursuit finds them again.

A trial plants ten activations of ``ani`` (201 filters, 32 x 64 x 32 rotations) in a map of 32 x 64:
random filters, places and twists, weights of 0.5 to 1.5 in each colour, and no two within one
filter width, which is the full width at half maximum of the wider one, along its longer axis. Ten
find room where filters are at most 34 degrees wide. It is coded with plain least squares and up to
30 sweeps of exchanges; found is a code with the same filters, places and twists (modulo the
filter's symmetry) and weights to 1e-4.
"""

import math
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.csc._coder import SphericalSparseCoder
from skylight.csc._dictionary import FilterBank
from skylight.csc._greedy import Atom, Pursuit, PursuitOptions, Support, pursue
from skylight.csc._least_squares import SampledSignal
from skylight.csc._positions import centres_of
from skylight.sphere._frame import angle_between

Code = dict[Atom, Float[Tensor, " c"]]
DICTIONARY = "ani"
HEIGHT, ACTIVATIONS, SWEEPS = 32, 10, 30
WIDEST_DEG = 34.0
CLOSE = 1e-4  # of the weights


def run_trial(number: int, seed: int) -> dict:
    """One trial in plain numbers."""
    coder, usable = _coder()
    generator = torch.Generator().manual_seed(1_000_003 * seed + number)
    planted = plant(coder, usable, generator)
    result = compared(coder, planted, find(coder, planted))
    return {"seed": seed, "trial": number, **result}


@cache
def _coder() -> tuple[SphericalSparseCoder, list[int]]:
    coder = SphericalSparseCoder(DICTIONARY, height=HEIGHT)
    wide = filter_widths(coder.bank)
    return coder, [i for i, w in enumerate(wide.tolist()) if math.degrees(w) <= WIDEST_DEG]


def filter_widths(bank: FilterBank) -> Float[Tensor, " m"]:
    """Full width at half maximum, along the longer of the two axes; 2 pi for what never halves."""
    theta = torch.linspace(0, math.pi, 721, dtype=torch.float64)
    zero = torch.zeros_like(theta)
    axes = [[zero, theta.cos(), theta.sin()], [theta.sin(), theta.cos(), zero]]
    values = torch.stack([bank.evaluate(torch.stack(axis, 1)) for axis in axes])
    above = values > 0.5 * values[..., :1]
    return 2 * (theta * above).amax((0, 2))


def plant(coder: SphericalSparseCoder, usable: list[int], generator: torch.Generator) -> Code:
    """Random activations, no two within the width of the wider filter."""
    positions, width = coder.parts[0].positions, filter_widths(coder.bank)
    sizes = (positions.rows, positions.columns, positions.twists)
    chosen: list[tuple[Atom, Tensor]] = []
    while len(chosen) < ACTIVATIONS:
        filter_ = usable[_draw(len(usable), generator)]
        place = (*(_draw(n, generator) for n in sizes),)
        direction = centres_of(positions.rotations(torch.tensor([place])))[0]
        if all(
            angle_between(direction, other) > max(width[filter_], width[atom[0]])
            for atom, other in chosen
        ):
            chosen.append((named(coder, (filter_, place)), direction))
    weights = 0.5 + torch.rand(ACTIVATIONS, 3, generator=generator, dtype=torch.float64)
    return {atom: weight for (atom, _), weight in zip(chosen, weights, strict=True)}


def find(coder: SphericalSparseCoder, planted: Code) -> Support:
    """The code of the planted one's map."""
    code = Support(
        filters=torch.tensor([filter_ for filter_, _ in planted]),
        places=torch.tensor([place for _, place in planted]),
        weights=torch.stack(list(planted.values())),
        error=0.0,
    )
    maps = coder.decode(code.tensors(coder.parts)).detach()
    options = PursuitOptions(weights="free", sweeps=SWEEPS)
    signal = SampledSignal.of(maps, coder.transform)
    return next(pursue(Pursuit(coder.parts, signal, options, coder.norms()), [len(planted)]))


def compared(coder: SphericalSparseCoder, planted: Code, support: Support) -> dict:
    """Whether they are one code, how many atoms are missing, and how far weights are off."""
    pairs = zip(support.filters.tolist(), support.places.tolist(), strict=True)
    names = [named(coder, (f, (p[0], p[1], p[2]))) for f, p in pairs]
    got = dict(zip(names, support.weights, strict=True))
    missed = len(planted.keys() - got.keys())
    error = None
    if not missed:
        error = max(float((got[atom] - weight).abs().max()) for atom, weight in planted.items())
    found = error is not None and len(got) == len(planted) and error < CLOSE
    return {"found": found, "missed": missed, "weight_error": error}


def named(coder: SphericalSparseCoder, atom: Atom) -> Atom:
    """The same atom by its first twist: a filter with an s-fold axis repeats after T / s."""
    filter_, (row, column, twist) = atom
    norms = coder.norms()
    assert norms is not None
    group, _ = coder.parts[0].plan().correlation.index[filter_]
    return filter_, (row, column, twist % norms[group].shape[0])


def _draw(below: int, generator: torch.Generator) -> int:
    return int(torch.randint(below, (1,), generator=generator))
