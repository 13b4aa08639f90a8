"""Boxes of pixels at every place, against boxes drawn pixel by pixel."""

from functools import cache

import pytest
import torch

from skylight.csc._sub_dictionaries import BoxCorrelation
from skylight.errors import InputError
from skylight.sphere._frame import DirectionGrid

F64 = torch.float64
ROWS = 7
SIZES = ((1, 1), (2, 3), (3, 2), (4, 14), (7, 1))
SOLID_ANGLES = DirectionGrid.latlong(ROWS).solid_angles.view(ROWS, 2 * ROWS)


def drawn(size: tuple[int, int], row: int, column: int) -> torch.Tensor:
    """A box of unit norm, middle (upper, left) pixel at this place; zeros beyond a pole."""
    out = torch.zeros(ROWS, 2 * ROWS, dtype=F64)
    top, left = row - (size[0] - 1) // 2, column - (size[1] - 1) // 2
    if not 0 <= top <= ROWS - size[0]:
        return out
    out[top : top + size[0], [(left + j) % (2 * ROWS) for j in range(size[1])]] = 1
    return out / (out.square() * SOLID_ANGLES).sum().sqrt()


def every_place() -> torch.Tensor:
    axes = (torch.arange(len(SIZES)), torch.arange(ROWS), torch.arange(2 * ROWS))
    return torch.cartesian_prod(*axes)


@cache
def every_box() -> torch.Tensor:
    return torch.stack([drawn(SIZES[f], r, c).flatten() for f, r, c in every_place().tolist()])


def test_boxes_are_drawn_at_their_places() -> None:
    filters, rows, columns = every_place().unbind(1)
    places = torch.stack([rows, columns, torch.zeros_like(rows)], 1)
    found = BoxCorrelation(ROWS, SIZES).rotated(filters, places)
    expected = every_box()
    torch.testing.assert_close(found, expected, atol=1e-14, rtol=1e-14)
    norms = found.square() @ DirectionGrid.latlong(ROWS).solid_angles
    there = norms > 0
    torch.testing.assert_close(norms[there], torch.ones_like(norms[there]))
    # of h rows, ROWS + 1 - h places
    expected_places = sum((ROWS + 1 - rows) * 2 * ROWS for rows, _ in SIZES)
    assert int(there.sum()) == expected_places


def test_correlations_are_products_with_every_box() -> None:
    residual = torch.randn(2, 2 * ROWS**2, generator=torch.Generator().manual_seed(0), dtype=F64)
    correlation = BoxCorrelation(ROWS, SIZES)
    (values,) = correlation.by_group(residual)
    assert values.shape == (2, 1, len(SIZES), ROWS, 2 * ROWS)
    expected = (residual @ every_box().T).view(2, 1, len(SIZES), ROWS, 2 * ROWS)
    torch.testing.assert_close(values, expected, atol=1e-12, rtol=0)
    (first, second) = correlation.in_chunks(residual)
    for n, chunk in enumerate((first, second)):
        torch.testing.assert_close(chunk.values[0].movedim(2, 0), values[n])


def test_a_box_larger_than_the_map_is_refused() -> None:
    with pytest.raises(InputError, match="8 rows and 1 columns do not fit a map of 7x14"):
        BoxCorrelation(7, ((8, 1), (1, 1)))
    with pytest.raises(InputError, match="1 rows and 15 columns do not fit"):
        BoxCorrelation(7, ((1, 15),))
