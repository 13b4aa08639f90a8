"""The sharpest filter there is: one pixel, for lamps and suns that no band limit can show."""

from collections.abc import Iterator

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from skylight.csc.correlation.chunk import Chunk, by_signal
from skylight.csc.correlation.positions import Positions
from skylight.sphere.grid import DirectionGrid


class PixelCorrelation(nn.Module):
    """``<p_w, r>`` for the unit pixels ``p_w = 1 / sqrt(dw)`` of a lat-long map of ``rows``.

    Answers like :class:`~skylight.csc.correlation.zonal.ZonalCorrelation`, for one filter. Its
    residual is that of pixels, ``dw (x - y)``, which follows the spherical harmonics' in what
    :class:`~skylight.csc.pursuit.quadratic.SampledSignal` calls coordinates.
    """

    root: Tensor

    def __init__(self, rows: int) -> None:
        super().__init__()
        self.positions = Positions(rows=rows, twists=1)
        self.index = {0: (0, 0)}
        root = DirectionGrid.latlong(rows).solid_angles.sqrt()
        self.register_buffer("root", root, persistent=False)

    def members(self, group: int) -> tuple[int, ...]:
        return (0,)

    def by_group(
        self, residual: Float[Tensor, "*batch n"]
    ) -> list[Float[Tensor, "*batch _ _ rows columns"]]:
        p, batch = self.positions, residual.shape[:-1]
        return [(residual / self.root.to(residual)).reshape(*batch, 1, 1, p.rows, p.columns)]

    def in_chunks(self, residuals: Float[Tensor, "s n"]) -> Iterator[Chunk]:
        """What :meth:`by_group` gives, a part at a time."""
        return by_signal(residuals, lambda some: self.by_group(some)[0])

    def rotated(
        self, filters: Int[Tensor, " s"], places: Int[Tensor, "s 3"]
    ) -> Float[Tensor, "s n"]:
        """The pixels at these places, as maps."""
        pixel = places[:, 0] * self.positions.columns + places[:, 1]
        out = self.root.new_zeros(len(places), len(self.root))
        out[torch.arange(len(places)), pixel] = 1 / self.root[pixel]
        return out
