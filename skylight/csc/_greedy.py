"""Greedy pursuits: the filters of a code, their rotations and weights.

:class:`Pursuit` takes one activation more at a time. :func:`pursue` gives codes of given sizes: a
pursuit, then exchanges that improve on its choices.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import max_pool2d, pad

from skylight._names import Sign
from skylight.csc._code import CodeTensors
from skylight.csc._least_squares import ActiveSet, Quadratic
from skylight.csc._search import Atom, Found, Query, Search, Values
from skylight.csc._sub_dictionaries import Part, part_of
from skylight.errors import InputError
from skylight.work._progress import Progress

_EXACT = 1e-12  # of the signal's energy: an error of the weights of 1e-6
_PEAK, _MOST_PEAKS = 0.4, 600  # a share of the highest; pairs are tried among so many
_ROOM = 192  # images at first: 144 activations and some rivals
WEAK_L1 = 1e-5  # of the largest correlation with the signal
_ROUNDING = 2e-6  # of the same: what is left in float32 of a correlation that is 0
_GAIN = 1e-9  # of the error: less is rounding
_PAIR_SWEEPS = 3  # of exchanges, with one activation too many


@dataclass(frozen=True, kw_only=True)
class PursuitOptions:
    """``weights``: which weights a refit allows.

    "nonnegative" (NNLS), "l1" (either sign, with a weak L1 norm: 6.6.3), or "free" (plain least
    squares). ``thresholding`` is Hard Thresholding Pursuit (6.4.6), otherwise the pursuit only
    adds (orthogonal matching pursuit). ``sweeps`` is how often, at most, each activation of
    a finished code is exchanged for a better one (:func:`pursue`), each costing about as much as
    finding the code, and the last, which try pairs, some times that.
    """

    weights: Sign = "l1"
    thresholding: bool = True
    sweeps: int = 0
    penalty: float = WEAK_L1

    def __post_init__(self) -> None:
        if self.weights not in get_args(Sign):
            raise InputError(f"weights {self.weights!r}: choose one of {', '.join(get_args(Sign))}")


@dataclass(frozen=True, kw_only=True)
class Support:
    """A pursuit's activations on its grid of rotations, and the squared error that they leave.

    Filter indices (s,), (row, column, twist) places (s,3), weights (s,c).
    """

    filters: Int[Tensor, " s"]
    places: Int[Tensor, "s 3"]
    weights: Float[Tensor, "s c"]
    error: float
    """Squared error, summed over colours."""

    def __len__(self) -> int:
        return len(self.filters)

    def tensors(self, parts: Sequence[Part], length: int | None = None) -> CodeTensors:
        """The code as tensors, padded to ``length`` activations where that is given."""
        rotations = torch.zeros(len(self), 3, dtype=torch.float64)
        number = torch.tensor([part_of(parts, f) for f in self.filters.tolist()])
        for n, part in enumerate(parts):
            mine = number == n
            rotations[mine] = part.positions.rotations(self.places[mine])
        missing = 0 if length is None else length - len(self)
        return CodeTensors(
            pad(self.filters, (0, missing)),
            pad(rotations, (0, 0, 0, missing)),
            pad(self.weights, (0, 0, 0, missing)),
            torch.tensor(len(self)),
        )


class Pursuit:
    """One activation more per step, until :meth:`step` finds nothing to add.

    With atoms a_j = R_j d_j, H and b of the :class:`~skylight.csc._least_squares.Quadratic`,
    and weights z, a step looks for the atom whose correlation ``<a, b - H sum_j z_j a_j>`` is
    largest, over all filters and rotations, and refits all weights. Colours share their
    activations: the correlation is that of the residual's principal colour (its mean colour where
    weights must not be negative), the refit is exact for each colour.

    Thresholding takes a gradient step ``u = z + mu * correlation`` and keeps the strongest t + 1
    atoms of those present and those found, so that it can exchange weak ones (Foucart 2011). It
    descends for certain: with mu <= 1 / (largest eigenvalue of the Gram matrix of the atoms
    involved), the quadratic with curvature 1 / mu lies above the error and touches it at z, and
    the kept atoms minimise it among all choices of t + 1 (the proximal steps of the L1 norm and of
    the bound leave this true, atom by atom). The refit can only lower the error further.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        objective: Quadratic,
        options: PursuitOptions,
        norms: Sequence[Values] | None = None,
    ) -> None:
        self.options = options
        self.search = Search(
            plans=[part.plan() for part in parts],
            absolute=options.weights != "nonnegative",
            norms=norms,
        )
        self._objective = objective
        self._target = objective.target.double()
        k, colours = self._target.shape
        self.filters: list[int] = []
        self.places: list[tuple[int, int, int]] = []
        self._images = self._target.new_zeros(_ROOM, k)  # H a_j, the first of them in use
        self._gram = np.zeros((0, 0))
        self._right = np.zeros((0, colours))
        self._sets: list[ActiveSet] = []
        (grey,) = _in_one_colour(self._target[None], options)
        (((self._scale, _),),) = self.search.strongest([Query(residual=grey, taken=())])
        penalty = options.penalty * self._scale if options.weights == "l1" else 0.0
        self._sets = [
            ActiveSet(penalty=penalty, nonnegative=options.weights == "nonnegative")
            for _ in range(colours)
        ]

    @property
    def penalty(self) -> float:
        return self._sets[0].penalty

    @property
    def weights(self) -> Float[np.ndarray, "s c"]:
        return np.stack([s.weights for s in self._sets], 1)

    def support(self) -> Support:
        z = self.weights
        error = self._objective.energy.double().cpu().numpy() - np.einsum(
            "sc,sc->c", z, 2 * self._right - self._gram @ z
        )
        return Support(
            filters=torch.tensor(self.filters, dtype=torch.long),
            places=torch.tensor(self.places, dtype=torch.long).reshape(-1, 3),
            weights=torch.from_numpy(z.copy()),
            error=float(error.sum()),
        )

    def step(self) -> bool:
        """One activation more; False where the colour searched for correlates with no atom."""
        return step_together([self])[0]

    def query(self, grey: Float[Tensor, " k"]) -> Query:
        """The search for the next activation, by one colour of the residual.

        Rivals are atoms that the longest step allowed by those in use would lift over the weakest.
        """
        if not (self.options.thresholding and self.filters):
            return Query(residual=grey, taken=self.atoms)
        least = float(np.linalg.norm(self.weights, axis=1).min())
        least *= float(np.linalg.eigvalsh(self._gram)[-1])
        return Query(residual=grey, taken=self.atoms, rivals=len(self.filters) + 1, least=least)

    def chosen(self, found: Sequence[Found]) -> list[Atom]:
        """The best atom found and its rivals; none where the best is as good as 0."""
        best, *rivals = found
        if best.value <= self.penalty + _ROUNDING * self._scale:
            return []
        return [best.atom, *(other.atom for other in rivals if other.atom != best.atom)]

    def accept(
        self,
        found: list[Atom],
        rotated: Float[Tensor, "n k"],
        images: Float[Tensor, "n k"],
    ) -> None:
        """One activation more of ``found``, or of those in use and ``found`` the strongest."""
        size = len(self.filters) + 1
        self._append(found, rotated, images)
        if len(found) > 1:
            self._threshold(size, len(found))
        self._refit()

    @property
    def exact(self) -> bool:
        """Whether the code explains the signal to rounding."""
        return self.support().error <= _EXACT * float(self._objective.energy.sum())

    @property
    def atoms(self) -> list[Atom]:
        return list(zip(self.filters, self.places, strict=True))

    def best(self) -> Atom | None:
        """The unused atom that correlates most with the residual; None where none does."""
        (grey,) = _in_one_colour(self.residual()[None], self.options)
        (found,) = self.search.strongest([Query(residual=grey, taken=self.atoms)])
        return next(iter(self.chosen(found)), None)

    def peaks(self) -> list[Atom]:
        """Unused atoms that correlate more than their neighbours, each filter at its own places.

        The strongest first, down to a share of the first; the constant has no peaks.
        """
        (grey,) = _in_one_colour(self.residual()[None], self.options)
        groups = self.search.everything(Query(residual=grey, taken=self.atoms))
        least = _PEAK * max(float(values.max()) for values, _, _ in groups)
        found: list[tuple[float, Atom]] = []
        for values, number, group in groups:
            over_twists, twists = values.max(0)
            around = pad(over_twists[None], (1, 1, 0, 0), mode="circular")[0]
            around = max_pool2d(pad(around, (0, 0, 1, 1))[:, None], 3, stride=1)[:, 0]
            high = (over_twists == around) & (over_twists > least)
            for place, row, column in torch.nonzero(high).tolist():
                spot = int(twists[place, row, column]), place, row, column
                atom = self.search.named(number, group, spot)
                if atom[0] not in self.search.plans[number].constant:
                    found.append((float(values[spot]), atom))
        return [atom for _, atom in sorted(found, reverse=True)[:_MOST_PEAKS]]

    def best_pair(self, atoms: list[Atom]) -> list[Atom]:
        """Those two of ``atoms`` that lower the error most together, all weights refitted freely.

        With the images of those in use projected out, G the Gram matrix of a pair and r its
        correlations with the residual, the error falls by ``sum_colours r^T G^-1 r``.
        """
        rotated = self.rotated(atoms)
        gram = (self.images(rotated) @ rotated.T).cpu().numpy()
        shared = (self._images[: len(self.filters)] @ rotated.T).cpu().numpy()
        gram = gram - shared.T @ np.linalg.pinv(self._gram) @ shared
        right = (rotated @ self.residual()).cpu().numpy()
        squared = right @ right.T
        own, power = gram.diagonal().clip(1e-9), squared.diagonal()
        both = np.outer(own, own)
        # pairs that are all but one atom have no determinant to divide by
        determinant = np.maximum(both - gram**2, 1e-6 * both)
        gain = np.outer(power, own) - 2 * gram * squared + np.outer(own, power)
        gain /= determinant
        np.fill_diagonal(gain, -1)
        first, second = np.unravel_index(gain.argmax(), gain.shape)
        return [atoms[first], atoms[second]]

    def nearest(self, atom: int) -> int:
        """The activation whose image is most like that of ``atom``."""
        length = np.sqrt(self._gram.diagonal())
        likeness = np.abs(self._gram[atom]) / length
        likeness[atom] = -1
        return int(likeness.argmax())

    def least_useful(self) -> int:
        """Leaving j out raises the squared error by ``z_j^2 / (G^-1)_jj``."""
        loss = np.square(self.weights).sum(1) / np.linalg.pinv(self._gram).diagonal()
        return int(loss.argmin())

    def drop(self, gone: Sequence[int], *, refit: bool = True) -> None:
        """Leave activations out; the others move up."""
        for atom in sorted(gone, reverse=True):
            self._drop(atom)
        if refit:
            self._refit()

    def add(self, atoms: list[Atom]) -> None:
        """Activations more, after the others; all weights are refitted."""
        rotated = self.rotated(atoms)
        self._append(atoms, rotated, self.images(rotated))
        self._refit()

    def residual(self) -> Float[Tensor, "k c"]:
        """``b - H sum_j z_j a_j``: minus half the gradient by the coefficients."""
        z = torch.from_numpy(self.weights).to(self._target)
        return self._target - self._images[: len(z)].T @ z

    def rotated(self, atoms: Sequence[Atom]) -> Float[Tensor, "n k"]:
        """Coordinates of atoms of the dictionary, float64."""
        plans = self.search.plans
        out = self._target.new_zeros(len(atoms), len(self._target))
        owners = [part_of(plans, filter_) for filter_, _ in atoms]
        for number, plan in enumerate(plans):
            mine = [j for j, owner in enumerate(owners) if owner == number]
            if mine:
                filters = torch.tensor([atoms[j][0] - plan.first for j in mine])
                places = torch.tensor([atoms[j][1] for j in mine])
                out[mine, plan.coordinates] = plan.correlation.rotated(filters, places).to(out)
        return out

    def images(self, rotated: Float[Tensor, "n k"]) -> Float[Tensor, "n k"]:
        """H a, for coordinates of atoms."""
        return self._objective.hessian(rotated.T).T

    def _append(
        self, found: list[Atom], rotated: Float[Tensor, "n k"], images: Float[Tensor, "n k"]
    ) -> None:
        old, new = len(self._gram), len(self._gram) + len(found)
        if new > len(self._images):
            more = self._images.new_zeros(new, self._images.shape[1])
            self._images = torch.cat([self._images, more])
        self._images[old:new] = images
        # one transfer from the device
        products = torch.cat([self._images[:new], self._target.T]) @ rotated.T
        block, right = np.split(products.cpu().numpy(), [new])
        gram = np.zeros((new, new))
        gram[:old, :old] = self._gram
        gram[:, old:] = block
        gram[old:, :old] = block[:old].T
        self._gram = gram
        self._right = np.concatenate([self._right, right.T])
        self.filters += [f[0] for f in found]
        self.places += [f[1] for f in found]
        for each in self._sets:
            for _ in found:
                each.grow()

    def _threshold(self, size: int, new: int) -> None:
        """Keep the ``size`` strongest after a gradient step, of the atoms present and ``new``."""
        z = self.weights
        gradient = self._right - self._gram @ z
        present = np.arange(len(z)) < len(z) - new
        # no step that involves these atoms may be longer
        step = 1 / np.linalg.eigvalsh(self._gram[np.ix_(present, present)])[-1]
        while True:
            u = z + step * gradient
            if self.options.weights == "nonnegative":
                u = np.maximum(u, 0)
            else:
                u = np.sign(u) * np.maximum(np.abs(u) - step * self.penalty, 0)
            strength = np.linalg.norm(u, axis=1)
            kept = np.sort(np.argsort(-strength, kind="stable")[:size])
            involved = np.flatnonzero(present | np.isin(np.arange(len(z)), kept))
            curvature = np.linalg.eigvalsh(self._gram[np.ix_(involved, involved)])[-1]
            if step * curvature <= 1 + 1e-9:
                break
            step = 1 / curvature
        for atom in sorted(set(range(len(z))) - set(kept.tolist()), reverse=True):
            self._drop(atom)

    def _drop(self, atom: int) -> None:
        del self.filters[atom], self.places[atom]
        rest = [i for i in range(len(self._gram)) if i != atom]
        self._images[atom : len(rest)] = self._images[atom + 1 : len(rest) + 1].clone()
        self._gram = self._gram[np.ix_(rest, rest)]
        self._right = self._right[rest]
        for each in self._sets:
            each.drop(atom)

    def _refit(self) -> None:
        for colour, each in enumerate(self._sets):
            each.solve(self._gram, self._right[:, colour])


def step_together(pursuits: Sequence[Pursuit]) -> list[bool]:
    """One activation more for each pursuit, all found in one search; False where nothing helps.

    The same as :meth:`Pursuit.step` of each, but for rounding. All must code in the same dictionary
    with the same options and Hessian: the first's are used.
    """
    first = pursuits[0]
    residuals = torch.stack([pursuit.residual() for pursuit in pursuits])
    greys = _in_one_colour(residuals, first.options)
    found = first.search.strongest([p.query(g) for p, g in zip(pursuits, greys, strict=True)])
    chosen = [p.chosen(each) for p, each in zip(pursuits, found, strict=True)]
    sizes = [len(atoms) for atoms in chosen]
    rotated = first.rotated([atom for atoms in chosen for atom in atoms])
    images = first.images(rotated)
    for pursuit, atoms, a, h in zip(
        pursuits, chosen, rotated.split(sizes), images.split(sizes), strict=True
    ):
        if atoms:
            pursuit.accept(atoms, a, h)
    return [bool(atoms) for atoms in chosen]


def _in_one_colour(
    residuals: Float[Tensor, "p k c"], options: PursuitOptions
) -> Float[Tensor, "p k"]:
    """The residuals' principal colours; the mean where weights must not be negative."""
    if options.weights == "nonnegative":
        return residuals.sum(2) * residuals.shape[2] ** -0.5
    grams = (residuals.mT @ residuals).cpu()  # of a few numbers each: no work for a device
    principal = torch.linalg.eigh(grams).eigenvectors[..., -1:]
    return (residuals @ principal.to(residuals))[..., 0]


def pursue(
    pursuit: Pursuit, counts: Sequence[int], progress: Progress | None = None
) -> Iterator[Support]:
    """The codes of ``counts`` activations (ascending); fewer where nothing more helps."""
    for count in counts:
        while len(pursuit.atoms) < count and pursuit.step():
            if progress is not None:
                progress(len(pursuit.atoms) / counts[-1])
        _sweep(pursuit)
        yield pursuit.support()


def pursue_together(pursuits: Sequence[Pursuit], count: int) -> list[Support]:
    """What :func:`pursue` gives for each, activation by activation for all of them.

    Exchanges are each pursuit's own.
    """
    going = [pursuit for pursuit in pursuits if len(pursuit.atoms) < count]
    while going:
        went = step_together(going)
        going = [p for p, more in zip(going, went, strict=True) if more and len(p.atoms) < count]
    for pursuit in pursuits:
        _sweep(pursuit)
    return [pursuit.support() for pursuit in pursuits]


def _sweep(pursuit: Pursuit) -> None:
    """Exchanges until none helps, or as often as the options allow."""
    for _ in range(pursuit.options.sweeps):
        if pursuit.exact or not (
            exchange(pursuit) or exchange(pursuit, refit=True) or exchange_pair(pursuit)
        ):
            break


def exchange(pursuit: Pursuit, *, refit: bool = False) -> int:
    """Look for a better atom in the place of each, the others as they are; how many changed.

    An exchange that does not lower the error is undone. Greedy choices are made while others are
    missing; sweeps of exchanges correct those (cyclic matching pursuit, Christensen, Jensen 2007).
    With ``refit`` the others' weights are fitted again before the search.
    """
    changed = 0
    for _ in range(len(pursuit.atoms)):
        before, old = pursuit.support().error, pursuit.atoms[0]
        pursuit.drop([0], refit=refit)
        new = pursuit.best() or old
        # what was left out moves to the end, so that the next in turn comes first
        pursuit.add([new])
        if new == old:
            continue
        if _better(pursuit, before):
            changed += 1
        else:
            pursuit.drop([len(pursuit.atoms) - 1], refit=False)
            pursuit.add([old])
    return changed


def exchange_pair(pursuit: Pursuit) -> bool:
    """Two atoms for one, or for one and its nearest, chosen together; whether one such try helped.

    It leads out of local minima in which one wide filter takes the place of two narrower ones, or
    two that of each other's halves, which no single exchange improves. Atoms are exchanged with one
    activation too many before the least useful is dropped. A try that did not help is undone.
    """
    before, old = pursuit.support().error, pursuit.atoms
    for neighbours in (False, True):
        for atom in old:
            gone = [pursuit.atoms.index(atom)]
            if neighbours and len(old) > 1:
                gone.append(pursuit.nearest(gone[0]))
            pursuit.drop(gone)
            _add_best_pair(pursuit, len(old))
            if _better(pursuit, before):
                return True
            pursuit.drop(range(len(pursuit.atoms)))
            pursuit.add(old)
    return False


def _add_best_pair(pursuit: Pursuit, count: int) -> None:
    """The best pair, exchanges of single atoms, and ``count`` activations again."""
    found = pursuit.peaks()
    if len(found) > 1:
        pursuit.add(pursuit.best_pair(found))
    while len(pursuit.atoms) <= count and pursuit.step():
        pass
    for _ in range(_PAIR_SWEEPS):
        if pursuit.exact or not exchange(pursuit):
            break
    while len(pursuit.atoms) > count:
        pursuit.drop([pursuit.least_useful()])
    while not pursuit.exact and exchange(pursuit):
        pass


def _better(pursuit: Pursuit, before: float) -> bool:
    return pursuit.support().error < before * (1 - _GAIN)
