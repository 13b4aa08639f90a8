import math

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from scipy.special import eval_legendre

from skylight.sphere import _harmonics as harmonics
from skylight.sphere._frame import DirectionGrid
from tests.oracles.harmonics import real_harmonics

F64 = torch.float64

# Orange Book (Rost 2006), Old Town / Grace cathedral listing; rows are L00, L1-1, L10, L11, ...
GRACE = torch.tensor(
    [
        [0.78908, 0.43710, 0.54161],
        [0.39499, 0.34989, 0.60488],
        [-0.33974, -0.18236, -0.26940],
        [-0.29213, -0.05562, 0.00944],
        [-0.11141, -0.05090, -0.12231],
        [-0.26240, -0.22401, -0.47479],
        [-0.15570, -0.09471, -0.14733],
        [0.56014, 0.21444, 0.13915],
        [0.21205, -0.05432, -0.30374],
    ],
    dtype=F64,
)


@pytest.fixture
def directions() -> torch.Tensor:
    axes = torch.cat([torch.eye(3, dtype=F64), -torch.eye(3, dtype=F64)])
    return torch.cat([axes, DirectionGrid.hammersley(200).directions])


def random_coefficients(degree: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn((degree + 1) ** 2, 3, generator=generator, dtype=F64)


def test_first_nine_are_those_of_the_table(directions: torch.Tensor) -> None:
    x, y, z = directions.unbind(1)
    table = [
        0.282095 * torch.ones_like(x),
        0.488603 * y,
        0.488603 * z,
        0.488603 * x,
        1.092548 * x * y,
        1.092548 * y * z,
        0.315392 * (3 * z**2 - 1),
        1.092548 * x * z,
        0.546274 * (x**2 - y**2),
    ]
    torch.testing.assert_close(
        harmonics.evaluate(directions, 2), torch.stack(table, 1), atol=1e-6, rtol=0
    )


@pytest.mark.parametrize("degree", [0, 1, 5, 40])
def test_agrees_with_scipy_poles_included(directions: torch.Tensor, degree: int) -> None:
    oracle = real_harmonics(directions.numpy(), degree)
    np.testing.assert_allclose(
        harmonics.evaluate(directions, degree).numpy(), oracle, atol=1e-10, rtol=0
    )


def test_addition_theorem_at_degree_100(directions: torch.Tensor) -> None:
    """sum_m Y_lm(w)^2 = (2 l + 1) / 4 pi for every w."""
    square = harmonics.evaluate(directions, 100) ** 2
    l = harmonics.bands(100)  # noqa: E741
    sums = torch.zeros(len(directions), 101, dtype=F64).index_add_(1, l, square)
    expected = (2 * torch.arange(101, dtype=F64) + 1) / (4 * math.pi)
    torch.testing.assert_close(sums, expected.expand_as(sums), rtol=1e-10, atol=0)


def test_gradients_are_right_and_finite_at_the_poles() -> None:
    points = torch.tensor([[0, 0, 1], [0, 0, -1], [0, 1, 0], [0.6, 0, 0.8]], dtype=F64)
    points.requires_grad_()
    assert torch.autograd.gradcheck(lambda d: harmonics.evaluate(d, 4), points)


def test_values_in_blocks_are_those_that_gradients_flow_through() -> None:
    """More directions than are evaluated together, and a last block that is shorter."""
    points = DirectionGrid.hammersley(2500).directions
    plain = harmonics.evaluate(points, 20)
    followed = harmonics.evaluate(points.clone().requires_grad_(), 20)
    torch.testing.assert_close(followed.detach(), plain, rtol=0, atol=1e-14)
    vmapped = torch.func.vmap(lambda p: harmonics.evaluate(p, 20))(points.reshape(5, 500, 3))
    torch.testing.assert_close(vmapped.flatten(0, 1), plain, rtol=0, atol=1e-14)
    assert harmonics.evaluate(points[:0], 3).shape == (0, 16)


@pytest.mark.parametrize(("degree", "bound"), [(4, 2e-6), (25, 1.5e-5), (60, 5e-5)])
def test_single_precision_costs_its_digits_only(degree: int, bound: float) -> None:
    points = DirectionGrid.hammersley(2000).directions.float()
    single, double = (harmonics.evaluate(p, degree) for p in (points, points.double()))
    assert single.dtype == torch.float32
    torch.testing.assert_close(single.double(), double, rtol=0, atol=bound)


def test_orthonormal_under_quadrature() -> None:
    grid = DirectionGrid.latlong(26)
    basis = harmonics.evaluate(grid.directions, 12)
    gram = harmonics.project(basis, grid, 12, method="quadrature")
    torch.testing.assert_close(gram, torch.eye(169, dtype=F64), atol=1e-12, rtol=0)


@pytest.mark.parametrize(
    ("degree", "rows", "method"), [(40, 82, "quadrature"), (20, 24, "least_squares")]
)
def test_round_trip(degree: int, rows: int, method: harmonics.ProjectionMethod) -> None:
    coefficients = random_coefficients(degree)
    grid = DirectionGrid.latlong(rows)
    radiance = harmonics.evaluate(grid.directions, degree) @ coefficients
    back = harmonics.project(radiance, grid, degree, method=method)
    torch.testing.assert_close(back, coefficients, atol=1e-9, rtol=0)


def test_least_squares_round_trip_without_a_layout() -> None:
    coefficients = random_coefficients(6)
    grid = DirectionGrid.hammersley(400)
    radiance = harmonics.evaluate(grid.directions, 6) @ coefficients
    back = harmonics.project(radiance, grid, 6, method="least_squares")
    torch.testing.assert_close(back, coefficients, atol=1e-10, rtol=0)


def test_solid_angle_projection_keeps_energy_exactly() -> None:
    grid = DirectionGrid.latlong(16)
    radiance = torch.rand(len(grid), 3, generator=torch.Generator().manual_seed(1), dtype=F64)
    first = harmonics.project(radiance, grid, 0)[0] * math.sqrt(4 * math.pi)
    torch.testing.assert_close(first, grid.solid_angles @ radiance, rtol=1e-13, atol=0)


def test_solid_angle_projection_converges_with_rows() -> None:
    coefficients = random_coefficients(4)
    errors = []
    for rows in (16, 32, 64):
        grid = DirectionGrid.latlong(rows)
        radiance = harmonics.evaluate(grid.directions, 4) @ coefficients
        errors.append((harmonics.project(radiance, grid, 4) - coefficients).abs().max().item())
    assert errors[1] < errors[0] / 3
    assert errors[2] < errors[1] / 3
    assert errors[2] < 5e-3


def test_projection_names_what_it_cannot_do() -> None:
    grid = DirectionGrid.latlong(16)
    radiance = torch.ones(len(grid), 3)
    with pytest.raises(ValueError, match="16 rows"):
        harmonics.project(radiance, grid, 8, method="quadrature")
    sky = DirectionGrid.sky(8)
    with pytest.raises(ValueError, match="full lat-long"):
        harmonics.project(torch.ones(len(sky), 3), sky, 2, method="quadrature")
    with pytest.raises(ValueError, match="directions"):
        harmonics.project(radiance[1:], grid, 2)


def test_cosine_coefficients_are_the_published_ones() -> None:
    pi = math.pi
    expected = [pi, 2 * pi / 3, pi / 4, 0, -pi / 24, 0, pi / 64, 0, -pi / 128, 0, 7 * pi / 1536]
    torch.testing.assert_close(
        harmonics.cosine_coefficients(10), torch.tensor(expected, dtype=F64), rtol=1e-14, atol=0
    )
    assert harmonics.cosine_coefficients(0).tolist() == [pi]


@pytest.mark.parametrize("l", [12, 20, 31, 40])
def test_cosine_coefficients_are_the_integral(l: int) -> None:  # noqa: E741
    """A_l = 2 pi int_0^1 u P_l(u) du."""
    integral = 2 * math.pi * quad(lambda u: u * eval_legendre(l, u), 0, 1, limit=200)[0]
    assert harmonics.cosine_coefficients(l)[l].item() == pytest.approx(integral, abs=1e-11)


@pytest.mark.parametrize(
    ("degree", "energy"), [(0, 0.375), (1, 0.875), (2, 0.992188), (4, 0.998047), (6, 0.999237)]
)
def test_energy_of_the_clamped_cosine(degree: int, energy: float) -> None:
    """Basri & Jacobs 2003: share of the kernel's energy in the first bands."""
    a = harmonics.cosine_coefficients(degree)
    l = torch.arange(degree + 1, dtype=F64)  # noqa: E741
    kernel_energy = ((2 * l + 1) / (4 * math.pi) * a**2).sum() / (2 * math.pi / 3)
    assert kernel_energy.item() == pytest.approx(energy, abs=6e-7)


def test_irradiance_of_a_point_light_errs_by_the_published_amount() -> None:
    """Relative L2 error of order 2 for a point light: sqrt(1 / 128) = 8.84 %."""
    grid = DirectionGrid.latlong(128)
    light = torch.tensor([[0.36, 0.48, 0.8]], dtype=F64)
    kernel = harmonics.cosine_coefficients(2)
    convolved = harmonics.convolve_zonal(harmonics.evaluate(light, 2).T, kernel)
    estimate = (harmonics.evaluate(grid.directions, 2) @ convolved)[:, 0]
    exact = (grid.directions @ light[0]).clamp(min=0)
    error = ((estimate - exact) ** 2) @ grid.solid_angles / (exact**2 @ grid.solid_angles)
    assert error.sqrt().item() == pytest.approx(math.sqrt(1 / 128), rel=1e-3)


def test_grace_cathedral_through_the_shader_polynomial(directions: torch.Tensor) -> None:
    """Ramamoorthi & Hanrahan 2001, eq. 13, with the constants as printed."""
    c1, c2, c3, c4, c5 = 0.429043, 0.511664, 0.743125, 0.886227, 0.247708
    l00, l1m, l10, l11, l2mm, l2m, l20, l21, l22 = GRACE
    x, y, z = (column[:, None] for column in directions.unbind(1))
    polynomial = (
        c1 * l22 * (x**2 - y**2)
        + c3 * l20 * z**2
        + c4 * l00
        - c5 * l20
        + 2 * c1 * (l2mm * x * y + l21 * x * z + l2m * y * z)
        + 2 * c2 * (l11 * x + l1m * y + l10 * z)
    )
    convolved = harmonics.convolve_zonal(GRACE, harmonics.cosine_coefficients(2))
    found = harmonics.evaluate(directions, 2) @ convolved
    torch.testing.assert_close(found, polynomial, atol=5e-6, rtol=0)


def test_convolution_scales_bands() -> None:
    coefficients = random_coefficients(2)
    kernel = torch.tensor([2.0, 3.0, 5.0], dtype=F64)
    out = harmonics.convolve_zonal(coefficients, kernel) / coefficients
    expected = torch.tensor([2.0, 3, 3, 3, 5, 5, 5, 5, 5], dtype=F64)[:, None]
    torch.testing.assert_close(out, expected.expand_as(out))
    with pytest.raises(ValueError, match="3 bands"):
        harmonics.convolve_zonal(coefficients, kernel[:2])


@pytest.mark.parametrize("kind", ["hann", "lanczos"])
def test_windows_fall_from_one_and_tame_ringing(kind: harmonics.WindowKind) -> None:
    factors = harmonics.window(8, kind)
    assert factors[0] == 1
    assert (torch.diff(factors) < 0).all()
    assert (factors > 0).all()
    grid = DirectionGrid.latlong(64)
    spike = harmonics.evaluate(torch.tensor([[0.0, 1.0, 0.0]], dtype=F64), 8).T
    basis = harmonics.evaluate(grid.directions, 8)
    ringing = -(basis @ spike).min()
    assert -(basis @ harmonics.convolve_zonal(spike, factors)).min() < 0.3 * ringing


def test_hann_and_lanczos_at_half_band() -> None:
    assert harmonics.window(3, "hann")[2].item() == pytest.approx(0.5)
    assert harmonics.window(3, "lanczos")[2].item() == pytest.approx(2 / math.pi)


@pytest.mark.parametrize("count", [0, 2, 8, 10])
def test_degree_of_refuses_what_is_no_square(count: int) -> None:
    with pytest.raises(ValueError, match=str(count)):
        harmonics.degree_of(count)
