"""Codes of given sizes: a greedy pursuit, then exchanges that improve on its choices."""

from collections.abc import Iterator, Sequence

from skylight.csc.pursuit.greedy import Pursuit, Support, step_together
from skylight.work.progress import Progress

_GAIN = 1e-9  # of the error: less is rounding
_SETTLING = 3  # sweeps with one activation too many


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
    two that of each other's halves, which no single exchange improves. Codes settle with one
    activation too many before the least useful is dropped. A try that did not help is undone.
    """
    before, old = pursuit.support().error, pursuit.atoms
    for neighbours in (False, True):
        for atom in old:
            gone = [pursuit.atoms.index(atom)]
            if neighbours and len(old) > 1:
                gone.append(pursuit.nearest(gone[0]))
            pursuit.drop(gone)
            _settle_with_pair(pursuit, len(old))
            if _better(pursuit, before):
                return True
            pursuit.drop(range(len(pursuit.atoms)))
            pursuit.add(old)
    return False


def _settle_with_pair(pursuit: Pursuit, count: int) -> None:
    found = pursuit.peaks()
    if len(found) > 1:
        pursuit.add(pursuit.best_pair(found))
    while len(pursuit.atoms) <= count and pursuit.step():
        pass
    for _ in range(_SETTLING):
        if pursuit.exact or not exchange(pursuit):
            break
    while len(pursuit.atoms) > count:
        pursuit.drop([pursuit.least_useful()])
    while not pursuit.exact and exchange(pursuit):
        pass


def _better(pursuit: Pursuit, before: float) -> bool:
    return pursuit.support().error < before * (1 - _GAIN)
