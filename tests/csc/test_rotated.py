import math

import pytest
import torch

from skylight.csc._wigner import complex_coefficients, real_coefficients, rotated_filters
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._rotation import matrix_from_euler, rotate

F64 = torch.float64
ALPHA = torch.tensor([0.0, 0.4, -2.5, 3.0, 1.0], dtype=F64)
BETA = torch.tensor([0.0, 0.7, 1.9, math.pi, 1e-9], dtype=F64)
GAMMA = torch.tensor([0.0, -1.2, 2.2, 0.5, 6.0], dtype=F64)
ANGLES = torch.stack([ALPHA, BETA, GAMMA], 1)


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


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


def test_the_zenith_goes_to_longitude_alpha_and_polar_angle_beta() -> None:
    """A zonal filter: the addition theorem, whatever the twist."""
    degree, height = 9, random(10)
    l = torch.arange(degree + 1)  # noqa: E741
    filters = torch.zeros(5, 100, dtype=F64)
    filters[:, l * (l + 1)] = height
    beta = BETA[:, None]
    pole = torch.stack([torch.cos(ALPHA), torch.sin(ALPHA)], 1) * torch.sin(beta)
    pole = torch.cat([pole, torch.cos(beta)], 1)
    scale = torch.sqrt(4 * math.pi / (2 * l + 1).double()) * height
    expected = harmonics.evaluate(pole, degree) * scale[harmonics.bands(degree)]
    turned = rotated_filters(filters, ANGLES)
    torch.testing.assert_close(turned, expected, atol=1e-12, rtol=0)


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
    assert torch.autograd.gradcheck(rotated_filters, [x.requires_grad_() for x in inputs])


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
