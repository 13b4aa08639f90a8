"""Correlation with isotropic filters, which twists do not change: products in the SH domain."""

from collections.abc import Iterator

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from skylight.csc.correlation.chunk import Chunk, by_signal
from skylight.csc.correlation.positions import Positions
from skylight.sphere import harmonics
from skylight.sphere.latlong_transform import LatLongTransform


def is_zonal(filters: Float[Tensor, "f k"]) -> bool:
    """Whether all filters are isotropic: nothing but rounding at orders other than 0."""
    squares = filters.double().square()
    other = squares[:, harmonics.orders(harmonics.degree_of(filters.shape[1])) != 0].sum(1)
    allowed = max(1e-12, torch.finfo(filters.dtype).eps ** 2)
    return bool((other <= allowed * squares.sum(1)).all())


class ZonalCorrelation(nn.Module):
    """``<R d_i, r>`` for isotropic d_i at every direction of ``positions`` (thesis, 6.4.3).

    ``B diag(Pi d_i) r`` with ``Pi = sqrt(4 pi / (2 l + 1))`` (Eq. 6.8, C.2): each filter scales the
    bands of the residual, and one transform per filter evaluates it at the directions. The same
    interface as :class:`~skylight.csc.correlation.wigner.RotationCorrelation`, at a fraction of its
    memory where the degree is high: K^2 rows numbers instead of K^3 rows.
    """

    bands: Tensor
    band_of: Tensor

    def __init__(
        self,
        filters: Float[Tensor, "f k"],
        positions: Positions,
        *,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        self.positions, self.dtype = positions, dtype
        self.degree = harmonics.degree_of(filters.shape[1])
        self.count = len(filters)
        self.index = {i: (0, i) for i in range(self.count)}
        if not is_zonal(filters):
            raise ValueError("only isotropic filters have a zonal correlation")
        self.register_buffer(
            "bands", harmonics.zonal_factors(filters.double()).to(dtype), persistent=False
        )
        self.register_buffer("band_of", harmonics.bands(self.degree), persistent=False)
        self.transform = LatLongTransform(self.degree, positions.rows).to(dtype)

    def members(self, group: int) -> tuple[int, ...]:
        return tuple(range(self.count))

    def by_group(
        self, residual: Float[Tensor, "*batch k"]
    ) -> list[Float[Tensor, "*batch _ _ rows columns"]]:
        """One group, one twist."""
        weighted = self.bands[:, self.band_of] * residual.to(self.bands)[..., None, :]
        return [self.transform.synthesise(weighted)[..., None, :, :, :]]

    def in_chunks(self, residuals: Float[Tensor, "s k"]) -> Iterator[Chunk]:
        """What :meth:`by_group` gives, a part at a time."""
        return by_signal(residuals, lambda some: self.by_group(some)[0])

    def rotated(
        self, filters: Int[Tensor, " s"], places: Int[Tensor, "s 3"]
    ) -> Float[Tensor, "s k"]:
        """``sqrt(4 pi / (2l + 1)) d_l Y_lm(direction)``: the addition theorem."""
        row, column, _ = places.to(self.bands.device).unbind(1)
        basis = self.transform.basis_at(row, column).double()
        return basis * self.bands.double()[filters.to(self.bands.device)][:, self.band_of]
