"""The grid on SO(3) of the rotations that activations may have.

Filters without a band limit: boxes of pixels, for the edges of lamps, windows and walls.

Correlations a part at a time: what looks at each value once need not keep them all.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn.functional import pad

from skylight.errors import InputError
from skylight.sphere._frame import DirectionGrid, direction_from_angles


@dataclass(frozen=True, kw_only=True)
class Positions:
    """``rows`` x ``2 rows`` lat-long directions (pixel centres), each with ``twists`` turns.

    A filter at the zenith goes to (row, column, twist) by ``Rz(alpha) Ry(beta) Rz(gamma)`` about
    the axes (+Z, +X, +Y): alpha is the longitude of the column (pi minus its azimuth), beta the
    zenith angle of the row, gamma = 2 pi twist / twists (thesis, 6.4.4: 32 x 64 x 32).
    """

    rows: int = 32
    twists: int = 32

    def __post_init__(self) -> None:
        if self.rows < 2 or self.twists < 1:
            raise InputError(
                f"positions need 2 or more rows and 1 or more twists, got {self.rows} and "
                f"{self.twists}"
            )

    @property
    def columns(self) -> int:
        return 2 * self.rows

    def __len__(self) -> int:
        """N T, the number of rotations."""
        return self.rows * self.columns * self.twists

    @property
    def beta(self) -> Float[Tensor, " rows"]:
        return (torch.arange(self.rows, dtype=torch.float64) + 0.5) * math.pi / self.rows

    @property
    def alpha(self) -> Float[Tensor, " columns"]:
        turn = (torch.arange(self.columns, dtype=torch.float64) + 0.5) / self.columns
        return 2 * math.pi * (1 - turn)

    @property
    def gamma(self) -> Float[Tensor, " twists"]:
        return torch.arange(self.twists, dtype=torch.float64) * 2 * math.pi / self.twists

    def rotations(self, places: Int[Tensor, "s 3"]) -> Float[Tensor, "s 3"]:
        """Euler angles (alpha, beta, gamma) of (row, column, twist) triples, float64."""
        row, column, twist = places.cpu().unbind(1)
        return torch.stack([self.alpha[column], self.beta[row], self.gamma[twist]], 1)

    def places(self, rotations: Float[Tensor, "s 3"]) -> Int[Tensor, "s 3"]:
        """The nearest (row, column, twist) triples: the inverse of :meth:`rotations`."""
        alpha, beta, gamma = rotations.cpu().unbind(1)
        row = (beta / math.pi * self.rows - 0.5).round().clamp(0, self.rows - 1)
        column = ((1 - alpha / (2 * math.pi)) * self.columns - 0.5).round() % self.columns
        twist = (gamma / (2 * math.pi) * self.twists).round() % self.twists
        return torch.stack([row, column, twist], 1).long()


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


Sizes = tuple[tuple[int, int], ...]


class BoxCorrelation(nn.Module):
    """``<p, r>`` for boxes p of a lat-long map's pixels, of unit norm: 1 / sqrt(solid angle).

    Filter i covers ``sizes[i]`` (rows, columns) of a map of ``rows``; 1 x 1 is the pixel, the
    sharpest filter there is. The place of a box is its middle pixel, of two the upper or left one.
    It may cross the seam, but no pole: places at which it would correlate with nothing.

    Answers like :class:`~skylight.csc._wigner.ZonalCorrelation`. Its residual is that of
    pixels, ``dw (x - y)``, which follows the spherical harmonics' in what
    :class:`~skylight.csc._active_set.SampledSignal` calls coordinates.

    Raises
    ------
    InputError
        A box that is larger than the map.
    """

    radiance: Tensor
    extent: Tensor

    def __init__(self, rows: int, sizes: Sizes) -> None:
        super().__init__()
        self.positions, self.sizes = Positions(rows=rows, twists=1), sizes
        self.index = {i: (0, i) for i in range(len(sizes))}
        largest = tuple(max(size) for size in zip(*sizes, strict=True))
        if largest[0] > rows or largest[1] > 2 * rows:
            raise InputError(
                f"boxes of {largest[0]} rows and {largest[1]} columns do not fit a map of "
                f"{rows}x{2 * rows}: use a finer map or another dictionary"
            )
        extent = torch.tensor(sizes)
        solid_angles = DirectionGrid.latlong(rows).solid_angles.view(rows, 2 * rows)
        top = torch.arange(rows) - (extent[:, :1] - 1) // 2
        inside = (top >= 0) & (top + extent[:, :1] <= rows)
        radiance = self._sums(solid_angles)[..., 0].rsqrt() * inside
        self.register_buffer("radiance", radiance, persistent=False)  # (filter, row)
        self.register_buffer("extent", extent, persistent=False)

    def _sums(self, values: Float[Tensor, "*batch rows columns"]) -> Float[Tensor, "*batch f _ _"]:
        """Sums over the boxes about every place, rows and then columns, 0 beyond the poles."""
        tall = {
            rows: pad(values, (0, 0, (rows - 1) // 2, rows // 2)).unfold(-2, rows, 1).sum(-1)
            for rows in {rows for rows, _ in self.sizes}
        }
        out = []
        for rows, columns in self.sizes:
            column = torch.arange(-((columns - 1) // 2), values.shape[-1] + columns // 2)
            round_ = tall[rows][..., (column % values.shape[-1]).to(values.device)]
            out.append(round_.unfold(-1, columns, 1).sum(-1))
        return torch.stack(out, -3)

    def members(self, group: int) -> tuple[int, ...]:
        return tuple(range(len(self.sizes)))

    def by_group(
        self, residual: Float[Tensor, "*batch n"]
    ) -> list[Float[Tensor, "*batch _ _ rows columns"]]:
        """One group, one twist."""
        p = self.positions
        sums = self._sums(residual.reshape(*residual.shape[:-1], p.rows, p.columns))
        return [(sums * self.radiance.to(residual)[..., None])[..., None, :, :, :]]

    def in_chunks(self, residuals: Float[Tensor, "s n"]) -> Iterator[Chunk]:
        """What :meth:`by_group` gives, a part at a time."""
        return by_signal(residuals, lambda some: self.by_group(some)[0])

    def spans(self, filters: Int[Tensor, " s"], places: Int[Tensor, "s 3"]) -> Int[Tensor, "s 4"]:
        """First row, rows, first column and columns of boxes; a first column may lie left of 0."""
        extent = self.extent[filters]
        first = places[:, :2].to(extent.device) - (extent - 1) // 2
        return torch.stack([first[:, 0], extent[:, 0], first[:, 1], extent[:, 1]], 1)

    def rotated(
        self, filters: Int[Tensor, " s"], places: Int[Tensor, "s 3"]
    ) -> Float[Tensor, "s n"]:
        """The boxes at these places, as maps."""
        device = self.radiance.device
        filters, places = filters.to(device), places.to(device)
        top, rows, left, columns = self.spans(filters, places)[:, :, None].unbind(1)
        row = torch.arange(self.positions.rows, device=device) - top
        column = (torch.arange(self.positions.columns, device=device) - left).remainder(
            self.positions.columns
        )
        down = ((row >= 0) & (row < rows)) * self.radiance[filters, places[:, 0], None]
        return (down[:, :, None] * (column < columns)[:, None]).flatten(1)
