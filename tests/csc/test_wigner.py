import math
from functools import cache

import pytest
import torch

from skylight.csc import _correlation as filter_group
from skylight.csc._positions import Positions
from skylight.csc._wigner import (
    RotationCorrelation,
    ZonalCorrelation,
    complex_coefficients,
    fold,
    real_coefficients,
    rotated_filters,
)
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._latlong_transform import LatLongTransform
from skylight.sphere._rotation import matrix_from_euler, rotate
from tests.csc.draws import F64, random


def orders(degree: int) -> torch.Tensor:
    l = harmonics.bands(degree)  # noqa: E741
    return torch.arange(len(l)) - l * (l + 1)


def filters_of_every_kind(degree: int, each: int = 2) -> torch.Tensor:
    """Isotropic, mirrored or not, with an axis of 2 or 3 or none, and the constant; mixed up."""
    m = orders(degree)
    kinds = [
        m == 0,
        (m >= 0) & (m % 2 == 0),
        m % 2 == 0,
        m % 3 == 0,
        (m >= 0) & (m % 3 == 0),
        m >= 0,
        m < m.numel(),
    ]
    filters = [random(len(m), seed=j) * kind for j in range(each) for kind in kinds]
    constant = torch.zeros_like(filters[0])
    constant[0] = 1
    return torch.stack([*filters, constant])


def all_places(p: Positions) -> torch.Tensor:
    axes = (torch.arange(n) for n in (p.rows, p.columns, p.twists))
    return torch.cartesian_prod(*axes)


def brute_force(
    filters: torch.Tensor, positions: Positions, residual: torch.Tensor
) -> torch.Tensor:
    """Every filter turned to every place, times the residual."""
    angles = positions.rotations(all_places(positions))
    shape = (positions.rows, positions.columns, positions.twists)
    products = [
        rotated_filters(one.expand(len(positions), -1), angles) @ residual for one in filters
    ]
    return torch.stack(products).view(-1, *shape)


# the columns tell orders below `rows` apart: degrees below, at, above it, and beyond all columns,
# the last so far that orders fold back more than once
@pytest.mark.parametrize(
    ("degree", "rows", "twists"),
    [(5, 8, 8), (6, 6, 12), (6, 5, 8), (7, 4, 6), (7, 3, 1), (4, 7, 5), (6, 3, 4), (15, 2, 3)],
)
def test_agrees_with_brute_force(degree: int, rows: int, twists: int) -> None:
    filters, positions = filters_of_every_kind(degree), Positions(rows=rows, twists=twists)
    residual = random(filters.shape[1], seed=9)
    expected = brute_force(filters, positions, residual)
    found = RotationCorrelation(filters, positions, dtype=F64)(residual)
    torch.testing.assert_close(found, expected, atol=1e-11, rtol=0)


def test_single_precision() -> None:
    filters, positions = filters_of_every_kind(12), Positions(rows=8, twists=8)
    residual = random(169, seed=9)
    exact = RotationCorrelation(filters, positions, dtype=F64)(residual)
    single = RotationCorrelation(filters, positions)(residual)
    assert single.dtype == torch.float32
    torch.testing.assert_close(single.double(), exact, atol=2e-6 * exact.abs().max().item(), rtol=0)


@pytest.mark.parametrize(("present", "twists", "expected"), [
    ([0], 12, 12), ([0, 2, 4], 12, 2), ([3, 6], 12, 3), ([3], 8, 1), ([2, 4], 8, 2),
    ([4], 6, 2), ([1], 12, 1), ([0, 2, 3], 12, 1),
])  # fmt: skip
def test_fold_counts_the_twists_that_repeat(present: list[int], twists: int, expected: int) -> None:
    spectrum = torch.zeros(8, 8, dtype=torch.complex128)
    spectrum[7, present] = 1j
    assert fold(spectrum, twists) == expected


def test_symmetric_filters_are_asked_for_fewer_twists() -> None:
    filters, positions = filters_of_every_kind(6), Positions(rows=4, twists=12)
    correlation = RotationCorrelation(filters, positions, dtype=F64)
    groups = correlation.by_group(random(49))
    whole = correlation(random(49))
    twists = {}
    for number, values in enumerate(groups):
        for place, member in enumerate(correlation.members(number)):
            assert correlation.index[member] == (number, place)
            twists[member] = values.shape[0]
            repeated = values[:, place].movedim(0, 2).repeat(1, 1, 12 // values.shape[0])
            assert torch.equal(repeated, whole[member])
    assert [twists[i] for i in range(7)] == [1, 6, 6, 4, 4, 12, 12]
    assert twists[14] == 1


def test_rotated_is_the_adjoint() -> None:
    """<z, C r> = <sum_j z_j R_j d_j, r>, and the rotated filters are the rotated filters."""
    filters, positions = filters_of_every_kind(7), Positions(rows=5, twists=6)
    correlation = RotationCorrelation(filters, positions, dtype=F64)
    generator = torch.Generator().manual_seed(3)
    places = all_places(positions)[torch.randperm(len(positions), generator=generator)[:60]]
    which = torch.randint(len(filters), (60,), generator=generator)
    atoms = correlation.rotated(which, places)
    expected = rotated_filters(filters[which], positions.rotations(places))
    torch.testing.assert_close(atoms, expected, atol=1e-12, rtol=0)
    residual, weights = random(64, seed=4), random(60, seed=5)
    values = correlation(residual)[which, places[:, 0], places[:, 1], places[:, 2]]
    torch.testing.assert_close(weights @ values, weights @ atoms @ residual)


def test_turning_a_map_by_columns_rolls_its_correlation() -> None:
    positions = Positions(rows=6, twists=4)
    correlation = RotationCorrelation(filters_of_every_kind(8), positions, dtype=F64)
    transform, map_ = LatLongTransform(8, positions.rows), random(6, 12)
    still = correlation(transform.analyse(map_))
    for columns in (1, 5):
        turned = correlation(transform.analyse(map_.roll(columns, 1)))
        torch.testing.assert_close(turned, still.roll(columns, 2), atol=1e-12, rtol=0)


def test_half_turn_about_a_horizontal_axis_permutes_places() -> None:
    """About +X, Q Rz(a) Ry(b) Rz(g) = Rz(pi - a) Ry(pi - b) Rz(g + pi).

    Rows go to rows - 1 - row, columns to rows - 1 - column, twists half round; pixels of a map too.
    """
    positions = Positions(rows=6, twists=4)
    correlation = RotationCorrelation(filters_of_every_kind(8), positions, dtype=F64)
    transform, map_ = LatLongTransform(8, positions.rows), random(6, 12)
    flipped = map_.flip(0, 1).roll(positions.rows, 1)
    still = correlation(transform.analyse(map_))
    expected = still.flip(1, 2).roll((positions.rows, -positions.twists // 2), (2, 3))
    found = correlation(transform.analyse(flipped))
    torch.testing.assert_close(found, expected, atol=1e-12, rtol=0)


@pytest.mark.parametrize(("degree", "rows"), [(5, 8), (9, 4), (40, 24)])
def test_zonal_correlation_is_the_rotation_correlation_of_isotropic_filters(
    degree: int, rows: int
) -> None:
    m, positions = orders(degree), Positions(rows=rows, twists=4)
    filters, residual = random(3, len(m)) * (m == 0), random(len(m), seed=1)
    zonal = ZonalCorrelation(filters, positions, dtype=F64)
    full = RotationCorrelation(filters, positions, dtype=F64)
    (a,), (b,) = zonal.by_group(residual), full.by_group(residual)
    torch.testing.assert_close(a, b, atol=1e-11, rtol=0)
    assert zonal.members(0) == full.members(0)
    assert zonal.index == full.index
    which, places = torch.tensor([2, 0]), torch.tensor([[1, 2, 0], [3, 0, 3]])
    atoms = zonal.rotated(which, places)
    torch.testing.assert_close(atoms, full.rotated(which, places), atol=1e-11, rtol=0)


def test_zonal_correlation_refuses_other_filters() -> None:
    with pytest.raises(ValueError, match="isotropic"):
        ZonalCorrelation(filters_of_every_kind(4), Positions(rows=4, twists=4))


@cache
def three_by_brute_force() -> tuple[RotationCorrelation, torch.Tensor, torch.Tensor]:
    """A correlation, three residuals and their products."""
    filters, positions = filters_of_every_kind(6), Positions(rows=5, twists=6)
    residuals = random(3, 49)
    expected = torch.stack([brute_force(filters, positions, r) for r in residuals])
    return RotationCorrelation(filters, positions, dtype=F64), residuals, expected


@pytest.mark.parametrize("budget", [1, 500, 4000, 10**6])
def test_the_share_taken_at_once_changes_nothing(
    budget: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Single rows, several of one signal, whole signals, and all together."""
    correlation, residuals, expected = three_by_brute_force()
    monkeypatch.setattr(filter_group, "_CACHED", budget)
    torch.testing.assert_close(correlation(residuals), expected, atol=1e-11, rtol=0)


def test_a_batch_is_its_residuals() -> None:
    """Of any leading dimensions."""
    correlation, residuals, expected = three_by_brute_force()
    found = correlation(residuals.view(3, 1, 49))
    torch.testing.assert_close(found.flatten(0, 1), expected, atol=1e-11, rtol=0)
    for values, alone in zip(
        correlation.by_group(residuals.view(3, 1, 49)),
        correlation.by_group(residuals[1]),
        strict=True,
    ):
        torch.testing.assert_close(values[1, 0], alone, atol=1e-12, rtol=0)
    assert correlation(residuals[:0, None]).shape == (0, *found.shape[1:])


ALPHA = torch.tensor([0.0, 0.4, -2.5, 3.0, 1.0], dtype=F64)
BETA = torch.tensor([0.0, 0.7, 1.9, math.pi, 1e-9], dtype=F64)
GAMMA = torch.tensor([0.0, -1.2, 2.2, 0.5, 6.0], dtype=F64)
ANGLES = torch.stack([ALPHA, BETA, GAMMA], 1)


@pytest.mark.parametrize("degree", [0, 3, 20])
def test_values_are_those_at_turned_back_directions(degree: int) -> None:
    """(R d)(w) = d(R^T w), in axes whose third is the zenith."""
    filters = random(5, (degree + 1) ** 2)
    directions = torch.nn.functional.normalize(random(40, 3, seed=1), dim=1)
    turned = rotated_filters(filters, ANGLES)
    for j, matrix in enumerate(matrix_from_euler(ALPHA, BETA, GAMMA)):
        values = harmonics.evaluate(directions, degree) @ turned[j]
        expected = harmonics.evaluate(directions @ matrix, degree) @ filters[j]
        torch.testing.assert_close(values, expected, atol=1e-12, rtol=0)


def test_agrees_with_rotation_by_real_blocks() -> None:
    filters = random(5, 41**2)
    turned = rotated_filters(filters, ANGLES)
    matrices = matrix_from_euler(ALPHA, BETA, GAMMA)
    for one, filter_, matrix in zip(turned, filters, matrices, strict=True):
        # euler_angles takes 1e-9 for the pole
        torch.testing.assert_close(one, rotate(filter_, matrix), atol=2e-6, rtol=0)
    torch.testing.assert_close(turned[0], filters[0], atol=1e-12, rtol=0)
    torch.testing.assert_close(turned.norm(dim=1), filters.norm(dim=1), rtol=1e-12, atol=0)


def test_complex_coefficients_there_and_back() -> None:
    coefficients = random(3, 64)
    spectrum = complex_coefficients(coefficients)
    torch.testing.assert_close(real_coefficients(spectrum), coefficients, atol=1e-15, rtol=0)
    # energy: orders m > 0 stand for -m too
    twice = torch.full((8,), 2.0, dtype=F64)
    twice[0] = 1
    energy = (spectrum.abs().square() * twice).sum((1, 2))
    torch.testing.assert_close(energy, coefficients.square().sum(1))


def test_gradients_in_filters_and_angles() -> None:
    inputs = [random(5, 16), ANGLES.clone()]
    inputs = [x.requires_grad_() for x in inputs]
    assert torch.autograd.gradcheck(rotated_filters, inputs, fast_mode=True)


def test_gradients_at_degree_40_are_finite_at_the_poles() -> None:
    angles = ANGLES.clone().requires_grad_()
    (rotated_filters(random(5, 41**2), angles) @ random(41**2, seed=1)).sum().backward()
    assert angles.grad is not None
    assert angles.grad.isfinite().all()


def test_equal_zenith_angles_share_their_wigner_functions() -> None:
    """Grids have few rows; in any order, and as one by one."""
    filters, angles = random(15, 49), ANGLES[[3, 1, 2, 1, 0, 3, 2, 4, 1, 1, 0, 2, 4, 3, 1]]
    alone = [rotated_filters(f[None], a[None])[0] for f, a in zip(filters, angles, strict=True)]
    torch.testing.assert_close(
        rotated_filters(filters, angles), torch.stack(alone), atol=1e-13, rtol=0
    )
    assert rotated_filters(filters[:0], angles[:0]).shape == (0, 49)
