"""Four ways to one gradient (thesis, 6.4.6: "verifying that they produce the same gradients")."""

import pytest
import torch

from skylight.csc._positions import Positions
from skylight.csc._wigner import RotationCorrelation, rotated_filters
from tests.csc.draws import F64, random
from tests.csc.thesis_gradients import IsotropicGradient, RotatedResiduals, RotatedZonalGradient

TOLERANCE = {torch.float32: 1e-4, F64: 1e-9}
GENERAL = [RotationCorrelation, RotatedResiduals, RotatedZonalGradient]


def isotropic(count: int, degree: int) -> torch.Tensor:
    l = torch.arange(degree + 1)  # noqa: E741
    filters = torch.zeros(count, (degree + 1) ** 2, dtype=F64)
    filters[:, l * (l + 1)] = random(count, degree + 1)
    return filters


def largest_difference(
    found: torch.Tensor, filters: torch.Tensor, positions: Positions, residual: torch.Tensor
) -> float:
    """To filters turned one by one, at 20 places of each, relative to the largest value."""
    shape = (positions.rows, positions.columns, positions.twists)
    assert found.shape == (len(filters), *shape)
    generator = torch.Generator().manual_seed(7)
    places = torch.stack([torch.randint(n, (20,), generator=generator) for n in shape], 1)
    rotations = positions.rotations(places)
    worst = 0.0
    for one, values in zip(filters, found, strict=True):
        exact = rotated_filters(one.expand(20, -1), rotations) @ residual
        here = values[tuple(places.unbind(1))].double()
        worst = max(worst, ((here - exact).abs().max() / exact.abs().max()).item())
    return worst


@pytest.mark.parametrize("dtype", TOLERANCE)
# degrees above the number of columns and below it
@pytest.mark.parametrize(
    ("degree", "rows", "twists"), [(0, 2, 1), (12, 4, 6), (12, 9, 3), (40, 4, 3)]
)
@pytest.mark.parametrize("method", GENERAL)
def test_every_method_is_the_products_with_turned_filters(
    method: type, degree: int, rows: int, twists: int, dtype: torch.dtype
) -> None:
    filters, residual = random(2, (degree + 1) ** 2), random((degree + 1) ** 2, seed=1)
    positions = Positions(rows=rows, twists=twists)
    found = method(filters, positions, dtype=dtype)(residual)
    assert found.dtype == dtype
    assert largest_difference(found, filters, positions, residual) < TOLERANCE[dtype]


@pytest.mark.parametrize("dtype", TOLERANCE)
@pytest.mark.parametrize(("degree", "rows"), [(12, 8), (40, 5)])
def test_all_four_agree_on_isotropic_filters(degree: int, rows: int, dtype: torch.dtype) -> None:
    filters, residual = isotropic(2, degree), random((degree + 1) ** 2, seed=1)
    positions = Positions(rows=rows, twists=2)
    default, *thesis = (
        method(filters, positions, dtype=dtype)(residual)
        for method in (*GENERAL, IsotropicGradient)
    )
    for found in thesis:
        assert found.shape == default.shape
        assert (found - default).abs().max() < TOLERANCE[dtype] * default.abs().max()


@pytest.mark.parametrize("method", [RotatedResiduals, RotatedZonalGradient])
def test_pieces_do_not_show(method: type, monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is bounded by pieces, the last of which is short."""
    filters, residual = random(3, 49), random(49, seed=1)
    gradient = method(filters, Positions(rows=5, twists=3), dtype=F64)
    whole = gradient(residual)
    monkeypatch.setattr("tests.csc.thesis_gradients._TWISTED_BYTES", 7 * 3 * 49 * 8)
    monkeypatch.setattr("tests.csc.thesis_gradients._LOOKUP_BYTES", 7 * 13 * 49 * 8)
    torch.testing.assert_close(gradient(residual), whole, atol=1e-12, rtol=0)


@pytest.mark.parametrize("degree", [3, 40])
def test_gradient_is_that_of_the_loss(degree: int) -> None:
    """-d/dz |x - sum_n z_n R_n d|^2 / 2 at z (Eq. 6.6), by autograd."""
    positions = Positions(rows=3, twists=2)
    filter_, signal = random(1, (degree + 1) ** 2), random((degree + 1) ** 2, seed=1)
    places = torch.cartesian_prod(torch.arange(3), torch.arange(6), torch.arange(2))
    atoms = rotated_filters(filter_.expand(36, -1), positions.rotations(places))
    codes = random(36, seed=2).requires_grad_()
    residual = signal - codes @ atoms
    (slope,) = torch.autograd.grad(residual.square().sum() / 2, codes)
    found = RotatedResiduals(filter_, positions, dtype=F64)(residual.detach())
    torch.testing.assert_close(found.flatten(), -slope, atol=1e-10, rtol=1e-10)
