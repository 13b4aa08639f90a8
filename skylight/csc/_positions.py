"""The grid on SO(3) of the rotations that activations may have, and correlations over it.

Correlations come a part at a time (:class:`Chunk`): a search looks at each value once and need not
keep them all.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.sphere._frame import direction_from_angles


@dataclass(frozen=True, kw_only=True)
class Positions:
    """``rows`` x ``2 rows`` lat-long directions (pixel centres), each with ``twists`` turns.

    A filter at the zenith goes to (row, column, twist) by ``Rz(alpha) Ry(beta) Rz(gamma)`` about
    the axes (+Z, +X, +Y): alpha is the longitude of the column (pi minus its azimuth), beta the
    zenith angle of the row, gamma = 2 pi twist / twists (thesis, 6.4.4: 32 x 64 x 32).
    """

    rows: int = 32
    twists: int = 32

    @property
    def columns(self) -> int:
        return 2 * self.rows

    def __len__(self) -> int:
        """N T, the number of rotations."""
        return self.rows * self.columns * self.twists

    @property
    def beta(self) -> Float[Tensor, " rows"]:
        return self.rotations(_along(0, self.rows))[:, 1]

    @property
    def alpha(self) -> Float[Tensor, " columns"]:
        return self.rotations(_along(1, self.columns))[:, 0]

    @property
    def gamma(self) -> Float[Tensor, " twists"]:
        return self.rotations(_along(2, self.twists))[:, 2]

    def rotations(self, places: Int[Tensor, "s 3"]) -> Float[Tensor, "s 3"]:
        """Euler angles (alpha, beta, gamma) of (row, column, twist) triples, float64."""
        row, column, twist = places.double().unbind(1)
        alpha = 2 * math.pi * (1 - (column + 0.5) / self.columns)
        beta = (row + 0.5) * math.pi / self.rows
        return torch.stack([alpha, beta, twist * 2 * math.pi / self.twists], 1)

    def places(self, rotations: Float[Tensor, "s 3"]) -> Int[Tensor, "s 3"]:
        """The nearest (row, column, twist) triples: the inverse of :meth:`rotations`."""
        alpha, beta, gamma = rotations.unbind(1)
        row = (beta / math.pi * self.rows - 0.5).round().clamp(0, self.rows - 1)
        column = ((1 - alpha / (2 * math.pi)) * self.columns - 0.5).round() % self.columns
        twist = (gamma / (2 * math.pi) * self.twists).round() % self.twists
        return torch.stack([row, column, twist], 1).long()


def _along(axis: int, count: int) -> Int[Tensor, "s 3"]:
    """The first places along one axis, at 0 of the others."""
    return torch.arange(count)[:, None] * (torch.arange(3) == axis)


def centres_of(rotations: Float[Tensor, "*s 3"]) -> Float[Tensor, "*s 3"]:
    """World directions of the centres of filters after these rotations (Euler angles)."""
    return direction_from_angles(math.pi - rotations[..., 0], rotations[..., 1])


class Chunk(NamedTuple):
    """The correlations of some signals with the filters of ``group``, at some rows of positions.

    Twists are those that differ. The values are the reader's own, to be changed as it likes. In
    memory they lie in this order, as FFTs over twists leave them, but for several signals.
    """

    group: int
    signals: slice
    rows: slice
    values: Float[Tensor, "s f b t columns"]


def by_signal(
    residuals: Float[Tensor, "s k"],
    correlate: Callable[[Float[Tensor, "_ k"]], Float[Tensor, "_ t f rows columns"]],
) -> Iterator[Chunk]:
    """All rows of one group, for as many signals at a time as the device is good at.

    One where a processor's cache holds few values, all where kernels should be few and long.
    """
    at_once = 1 if residuals.device.type == "cpu" else max(1, len(residuals))
    for start in range(0, len(residuals), at_once):
        some = slice(start, start + at_once)
        values = correlate(residuals[some])
        yield Chunk(0, some, slice(0, values.shape[-2]), values.movedim(1, 3))
