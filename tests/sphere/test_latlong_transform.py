import pytest
import torch

from skylight.sphere import _harmonics as harmonics
from skylight.sphere._latlong_transform import LatLongTransform

F64 = torch.float64


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


# degrees below, at and beyond what the columns can tell apart
@pytest.fixture(params=[(0, 2), (3, 8), (5, 7), (8, 8), (11, 4), (40, 32)], ids=str)
def transform(request: pytest.FixtureRequest) -> LatLongTransform:
    degree, height = request.param
    return LatLongTransform(degree, height)


def dense(transform: LatLongTransform) -> torch.Tensor:
    return harmonics.evaluate_about_zenith(transform.grid.directions, transform.degree)


def test_synthesis_is_the_basis(transform: LatLongTransform) -> None:
    basis = dense(transform)
    coefficients = random(basis.shape[1])
    maps = transform.synthesise(coefficients)
    assert maps.shape == transform.grid.layout
    torch.testing.assert_close(maps.flatten(), basis @ coefficients, atol=1e-11, rtol=0)


def test_analysis_is_the_weighted_transpose(transform: LatLongTransform) -> None:
    basis, (height, width) = dense(transform), transform.grid.layout or (0, 0)
    maps = random(height, width)
    expected = basis.T @ (transform.grid.solid_angles * maps.flatten())
    torch.testing.assert_close(transform.analyse(maps), expected, atol=1e-11, rtol=0)


def test_adjoint(transform: LatLongTransform) -> None:
    """<B c, x>_W = <c, B^T W x>."""
    height, width = transform.grid.layout or (0, 0)
    maps, coefficients = random(height, width), random((transform.degree + 1) ** 2, seed=1)
    left = (transform.synthesise(coefficients) * maps).flatten() @ transform.grid.solid_angles
    torch.testing.assert_close(left, coefficients @ transform.analyse(maps))


def test_gram_tends_to_one_with_the_rows() -> None:
    errors = []
    for height in (16, 32, 64):
        transform = LatLongTransform(4, height)
        gram = transform.analyse(transform.synthesise(torch.eye(25, dtype=F64)))
        torch.testing.assert_close(gram, gram.T, atol=1e-14, rtol=0)
        errors.append((gram - torch.eye(25, dtype=F64)).abs().max().item())
    assert errors[1] < errors[0] / 3
    assert errors[2] < errors[1] / 3
    assert errors[2] < 5e-3


def test_leading_dimensions() -> None:
    transform = LatLongTransform(3, 5)
    coefficients = random(2, 3, 16)
    maps = transform.synthesise(coefficients)
    assert maps.shape == (2, 3, 5, 10)
    torch.testing.assert_close(maps[1, 2], transform.synthesise(coefficients[1, 2]))
    torch.testing.assert_close(transform.analyse(maps)[1, 2], transform.analyse(maps[1, 2]))


def test_precision_is_that_of_what_comes() -> None:
    transform = LatLongTransform(6, 9)
    coefficients = random(49)
    single = transform.synthesise(coefficients.float())
    assert single.dtype == transform.analyse(single).dtype == torch.float32
    exact = transform.synthesise(coefficients)
    torch.testing.assert_close(single.double(), exact, atol=1e-5, rtol=0)


def test_gradients() -> None:
    transform = LatLongTransform(3, 4)
    coefficients = random(2, 16).requires_grad_()
    maps = random(2, 4, 8).requires_grad_()
    assert torch.autograd.gradcheck(transform.synthesise, coefficients)
    assert torch.autograd.gradcheck(transform, maps)  # a call analyses
