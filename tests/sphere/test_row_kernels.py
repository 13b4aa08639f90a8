"""Kernels along rows against the matrices that they stand for."""

import pytest
import torch

from skylight.sphere._frame import DirectionGrid, squared_chords
from skylight.sphere._row_kernels import RowKernels


def lobes(grid: DirectionGrid, centres: torch.Tensor) -> torch.Tensor:
    """Not the same in each row of centres, nor in each row of the grid."""
    towards = (1 + 0.3 * centres[:, 1]) * (2 + grid.directions[:, 1:2])
    return towards * torch.exp(-4 * squared_chords(grid.directions, centres))


GRIDS = [
    (DirectionGrid.latlong(16), DirectionGrid.latlong(16)),
    (DirectionGrid.latlong(16), DirectionGrid.latlong(8)),
    (DirectionGrid.sky(16), DirectionGrid.sky(8)),
    (DirectionGrid.sky(8), DirectionGrid.sky(8)),
]


@pytest.mark.parametrize(("fine", "coarse"), GRIDS)
def test_both_products_are_those_of_the_matrix(fine: DirectionGrid, coarse: DirectionGrid) -> None:
    matrix = lobes(fine, coarse.directions)
    kernels = RowKernels.of(lobes, fine, coarse)
    generator = torch.Generator().manual_seed(0)
    amounts = torch.rand(len(coarse), generator=generator, dtype=torch.float64)
    field = torch.rand(len(fine), generator=generator, dtype=torch.float64)
    torch.testing.assert_close(kernels.spread(amounts), matrix @ amounts, rtol=1e-10, atol=1e-12)
    torch.testing.assert_close(kernels.gathered(field), field @ matrix, rtol=1e-10, atol=1e-12)


def test_columns_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="no multiple"):
        RowKernels.of(lobes, DirectionGrid.latlong(16), DirectionGrid.latlong(12))
