"""Correlations a part at a time: what looks at each value once need not keep them all."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor


class Chunk(NamedTuple):
    """The correlations of some signals with the filters of ``group``, at some rows of positions.

    Twists are those that differ. The values are the reader's own, to be changed as it likes. In
    memory they lie in this order, as FFTs over twists leave them, but for several signals.
    """

    group: int
    signals: slice
    rows: slice
    values: Float[Tensor, "s f b t columns"]


def signals_at_once(device: torch.device, count: int) -> int:
    """One where a processor's cache holds few values, all where kernels should be few and long."""
    return 1 if device.type == "cpu" else max(1, count)


def by_signal(
    residuals: Float[Tensor, "s k"],
    correlate: Callable[[Float[Tensor, "_ k"]], Float[Tensor, "_ t f rows columns"]],
) -> Iterator[Chunk]:
    """All rows of one group, for as many signals at a time as the device is good at."""
    at_once = signals_at_once(residuals.device, len(residuals))
    for start in range(0, len(residuals), at_once):
        some = slice(start, start + at_once)
        values = correlate(residuals[some])
        yield Chunk(0, some, slice(0, values.shape[-2]), values.movedim(1, 3))
