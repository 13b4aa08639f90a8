"""Training, validation and test days, drawn by rejection (thesis, 5.3.3.1).

Each set has a similar mixture of sunny and overcast skies, and all skies of one capture day are
in one set.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import get_args

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from skylight.errors import InputError
from skylight.skies.index import SkyRecord, Split

SHARES = (0.8, 0.1, 0.1)
TRIES = 5000
SUNNY = 0.5  # transmittance from which on a sky counts as sunny
_SEED = 20180101


def assign_splits(
    records: Sequence[SkyRecord],
    *,
    seed: int,
    shares: tuple[float, float, float] = SHARES,
    tolerance: float = 0.05,
) -> dict[str, Split]:
    """The split of each day: the first of at most :data:`TRIES` random draws that is near enough.

    A draw puts the days into a random order and cuts it into test, validation and training
    days. It is near enough where, for each split, both its share of all skies is within
    ``tolerance`` of ``shares`` (train, validation, test), and its share of sunny skies within
    ``tolerance`` of that of all skies. A split with a share above 0 gets at least one day.

    The same records, in any order, and the same seed give the same days.

    Raises :class:`InputError` where no draw is near enough, naming the best one's distance.
    """
    if min(shares) < 0 or not math.isclose(sum(shares), 1, abs_tol=1e-9):
        raise InputError(f"the shares of the splits must be >= 0 and sum to 1, got {shares}")
    names = sorted({r.day for r in records})
    wanted = sum(share > 0 for share in shares)
    if len(names) < wanted:
        raise InputError(
            f"{len(names)} day(s) cannot be divided into {wanted} sets without a day in two of "
            "them: add days"
        )
    number = {name: i for i, name in enumerate(names)}
    skies = np.zeros((len(names), 2))  # of each day: sunny, others
    for record in records:
        skies[number[record.day], int(record.sun_transmittance < SUNNY)] += 1
    rng = np.random.default_rng(seed)
    best = math.inf
    for _ in range(TRIES):
        order = rng.permutation(len(names))
        sets = _cut(order, skies.sum(1), shares)
        distance = _distance(sets, skies, shares)
        if distance <= tolerance:
            splits = zip(get_args(Split), sets, strict=True)
            return {names[i]: split for split, days in splits for i in days}
        best = min(best, distance)
    raise InputError(
        f"no division of the {len(names)} days into training, validation and test days was within "
        f"{tolerance:g} of shares of {', '.join(f'{s:g}' for s in shares)} with the same part of "
        f"sunny skies; the best of {TRIES} draws was within {best:.2f}: add days or allow more"
    )


def divide(records: Sequence[SkyRecord], *, tolerance: float | None = None) -> list[SkyRecord]:
    """The records with their splits: 8 in 10 skies to train on, 1 in 10 each for the others.

    The default tolerance is 0.05, or 10 / days where the days are fewer than 200, since a set of
    k days meets a mixture only to about 1 / k. One or two days cannot be divided: they are
    training days.
    """
    days = len({r.day for r in records})
    if days < len(SHARES):
        return [replace(r, split="train") for r in records]
    tolerance = max(0.05, 10 / days) if tolerance is None else tolerance
    splits = assign_splits(records, seed=_SEED, tolerance=tolerance)
    return [replace(r, split=splits[r.day]) for r in records]


def _cut(
    order: NDArray[np.int64], skies: Float[np.ndarray, " d"], shares: tuple[float, float, float]
) -> list[NDArray[np.int64]]:
    """[train, validation, test] from an order of days, the nearest cuts to the shares of skies."""
    total = np.concatenate([[0.0], np.cumsum(skies[order])]) / skies.sum()
    cuts = [0]
    for rank, share in enumerate((shares[2], shares[1])):
        left = rank == 0 and shares[1] > 0
        most = len(order) - (shares[0] > 0) - left  # the sets to come want a day each
        least = cuts[-1] + (share > 0)
        near = np.abs(total[least : most + 1] - total[cuts[-1]] - share)
        cuts.append(cuts[-1] if share == 0 else least + int(near.argmin()))
    test, validation, train = np.split(order, cuts[1:])
    return [train, validation, test]


def _distance(
    sets: list[NDArray[np.int64]],
    skies: Float[np.ndarray, "d 2"],
    shares: tuple[float, float, float],
) -> float:
    """The largest difference of a set's share of skies, or of its part of sunny ones."""
    every = skies.sum(0)
    worst = 0.0
    for days, share in zip(sets, shares, strict=True):
        found = skies[days].sum(0)
        worst = max(worst, abs(found.sum() / every.sum() - share))
        if found.sum():
            worst = max(worst, abs(found[0] / found.sum() - every[0] / every.sum()))
    return float(worst)
