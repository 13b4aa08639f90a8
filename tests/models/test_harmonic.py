import math

import pytest
import torch

from skylight.models._harmonic import HarmonicLight, solve_linear
from skylight.sphere import _harmonics as harmonics

F64 = torch.float64


def random_params(model: HarmonicLight, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(2, model.parameter_count, generator=generator, dtype=F64)


@pytest.mark.parametrize(("degree", "name", "count"), [(2, "sh9", 27), (4, "sh25", 75)])
def test_names_and_counts(degree: int, name: str, count: int) -> None:
    model = HarmonicLight(degree)
    assert (model.name, model.parameter_count) == (name, count)
    assert model.basis.shape == (64 * 128, (degree + 1) ** 2)


def test_parameters_are_coefficients_then_colours() -> None:
    model = HarmonicLight(2, 8)
    params = torch.zeros(1, 27, dtype=F64)
    params[0, 3 * 1 + 2] = 1.0  # Y_1-1, blue
    expected = torch.zeros(len(model.grid), 3, dtype=F64)
    expected[:, 2] = 0.488603 * model.grid.directions[:, 1]
    torch.testing.assert_close(model.linear_radiance(params)[0], expected, atol=1e-6, rtol=0)


def test_radiance_is_the_linear_one_cut_at_zero() -> None:
    model = HarmonicLight(4, 16)
    linear = model.linear_radiance(random_params(model))
    assert linear.min() < 0
    assert torch.equal(model(random_params(model)), linear.clamp(min=0))


def test_projection_gives_the_parameters_back() -> None:
    model = HarmonicLight(4, 16)
    params = random_params(model)
    back = harmonics.project(model.linear_radiance(params)[0], model.grid, 4, method="quadrature")
    torch.testing.assert_close(back.flatten(), params[0])


def test_starts_have_a_mean_luminance_of_one_above() -> None:
    for model in (HarmonicLight(2), HarmonicLight(4)):
        upper = (model.grid.directions[:, 1] > 0) * model.grid.solid_angles / (2 * math.pi)
        towards = model.starts_towards(torch.eye(3))
        assert towards.shape == (3, 2, model.parameter_count)
        for params in (model.starts(), towards.flatten(0, 1)):
            mean = torch.einsum("n,bnc->bc", upper, model.linear_radiance(params.double()))
            torch.testing.assert_close(mean, torch.ones_like(mean), atol=1e-6, rtol=0)


def test_starts_towards_are_brightest_there() -> None:
    model = HarmonicLight(2)
    directions = torch.nn.functional.normalize(torch.tensor([[1.0, 1, 0], [0.2, 0.5, -1]]))
    light = model(model.starts_towards(directions)[:, 1])[..., 0]
    brightest = model.grid.directions[light.argmax(1)].float()
    assert ((brightest * directions).sum(1) > math.cos(math.radians(3))).all()


# --- linear least squares


def problem(rows: int, columns: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    matrix = torch.randn(rows, columns, generator=generator, dtype=F64)
    return matrix, torch.randn(columns, 3, generator=generator, dtype=F64)


def test_solve_linear_recovers_exact_shading() -> None:
    matrix, truth = problem(200, 9)
    found = solve_linear(matrix, matrix @ truth, torch.ones(200, dtype=F64), ridge=1e-14)
    torch.testing.assert_close(found, truth, rtol=1e-9, atol=1e-9)
    # the default ridge moves it by parts in a million
    default = solve_linear(matrix, matrix @ truth, torch.ones(200, dtype=F64))
    torch.testing.assert_close(default, truth, rtol=0, atol=1e-5)


def test_solve_linear_obeys_the_normal_equations() -> None:
    matrix, _ = problem(50, 4)
    generator = torch.Generator().manual_seed(3)
    pixels = torch.rand(50, 3, generator=generator, dtype=F64)
    weights = torch.rand(50, generator=generator, dtype=F64)
    found = solve_linear(matrix, pixels, weights, ridge=0.1)
    weighted = weights[:, None] * matrix
    gram = matrix.T @ weighted
    damped = gram + 0.1 * gram.trace() / 4 * torch.eye(4, dtype=F64)
    torch.testing.assert_close(damped @ found, weighted.T @ pixels)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_solve_linear_survives_fewer_pixels_than_coefficients(dtype: torch.dtype) -> None:
    matrix, truth = problem(5, 25)
    matrix, pixels = matrix.to(dtype), (matrix @ truth).to(dtype)
    found = solve_linear(matrix, pixels, torch.ones(5, dtype=dtype))
    torch.testing.assert_close(matrix @ found, pixels, rtol=1e-2, atol=1e-2)
    assert found.norm() <= truth.norm() * 1.001
