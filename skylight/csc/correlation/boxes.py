"""Filters without a band limit: boxes of pixels, for the edges of lamps, windows and walls."""

from collections.abc import Iterator

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn.functional import pad

from skylight.csc.correlation.chunk import Chunk, by_signal
from skylight.csc.correlation.positions import Positions
from skylight.errors import InputError
from skylight.sphere.grid import DirectionGrid

Sizes = tuple[tuple[int, int], ...]


class BoxCorrelation(nn.Module):
    """``<p, r>`` for boxes p of a lat-long map's pixels, of unit norm: 1 / sqrt(solid angle).

    Filter i covers ``sizes[i]`` (rows, columns) of a map of ``rows``; 1 x 1 is the pixel, the
    sharpest filter there is. The place of a box is its middle pixel, of two the upper or left one.
    It may cross the seam, but no pole: places at which it would correlate with nothing.

    Answers like :class:`~skylight.csc.correlation.zonal.ZonalCorrelation`. Its residual is that of
    pixels, ``dw (x - y)``, which follows the spherical harmonics' in what
    :class:`~skylight.csc.pursuit.quadratic.SampledSignal` calls coordinates.

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
