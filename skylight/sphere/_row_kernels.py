"""Kernels between lat-long grids that depend on rows and on the difference of azimuths alone.

Along rows they are circular convolutions, so what takes a matrix of n k numbers takes rows of one
column, and Fourier transforms: exact but for rounding.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from skylight.sphere._frame import DirectionGrid


@dataclass(frozen=True, kw_only=True)
class RowKernels:
    """K(w, d) of directions w of a ``fine`` grid and d of one whose columns are ``step`` of its.

    ``spectra`` (h,f,r): along each fine row, of those d that are first in their r rows.
    """

    spectra: Complex[Tensor, "h f r"]
    width: int
    step: int

    @staticmethod
    def of(
        kernel: Callable[[DirectionGrid, Float[Tensor, "r 3"]], Float[Tensor, "n r"]],
        fine: DirectionGrid,
        coarse: DirectionGrid,
    ) -> "RowKernels":
        """Of what depends on rows and on differences of azimuths alone.

        Raises
        ------
        ValueError
            The fine grid's columns are no multiple of the coarse one's.
        """
        assert fine.layout is not None
        assert coarse.layout is not None
        (rows, width), (_, columns) = fine.layout, coarse.layout
        if width % columns:
            raise ValueError(f"{width} columns are no multiple of {columns}")
        first = kernel(fine, coarse.directions[::columns]).unflatten(0, (rows, width))
        return RowKernels(spectra=torch.fft.rfft(first, dim=1), width=width, step=width // columns)

    def spread(self, amounts: Float[Tensor, " k"]) -> Float[Tensor, " n"]:
        """sum_d K(w, d) x_d for amounts x in the directions d."""
        rows = amounts.unflatten(0, (self.spectra.shape[2], -1))
        placed = rows.new_zeros(len(rows), self.width)
        placed[:, :: self.step] = rows
        product = torch.einsum("hfr,rf->hf", self.spectra, torch.fft.rfft(placed, dim=1))
        return torch.fft.irfft(product, self.width, dim=1).flatten()

    def gathered(self, field: Float[Tensor, " n"]) -> Float[Tensor, " k"]:
        """sum_w K(w, d) x_w for a field x in the directions w."""
        spectrum = torch.fft.rfft(field.unflatten(0, (-1, self.width)), dim=1)
        product = torch.einsum("hfr,hf->rf", self.spectra.conj(), spectrum)
        return torch.fft.irfft(product, self.width, dim=1)[:, :: self.step].flatten()
