import math

import pytest
import torch
from scipy.optimize import LinearConstraint, minimize

from skylight.errors import InputError
from skylight.inverse._harmonic import nonnegative_harmonics
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._frame import DirectionGrid
from tests.probes.objects import GRID, ring_and_ball, transfer_of

CONSTRAINTS = DirectionGrid.hammersley(1024)
TABLE = harmonics.evaluate(CONSTRAINTS.directions, 4)
FINE = DirectionGrid.latlong(180)


@pytest.fixture(scope="module")
def operator() -> torch.Tensor:
    """Of the ring and ball's points, for degree 4."""
    functions = transfer_of(ring_and_ball(), 80).functions[..., 0].double()
    basis = harmonics.evaluate(GRID.directions, 4)
    return (functions * GRID.solid_angles) @ basis


def lamps(count: int, seed: int = 0) -> torch.Tensor:
    """Degree-4 coefficients (25,count) of lights that are negative nowhere: squares of degree 2."""
    generator = torch.Generator().manual_seed(seed)
    fine = harmonics.evaluate(FINE.directions, 2)
    part = fine @ torch.randn(9, count, generator=generator, dtype=torch.float64)
    return harmonics.project(part.square(), FINE, 4, method="least_squares")


def noisy(shading: torch.Tensor, noise: float, seed: int = 1) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    scale = noise * shading.square().mean(0).sqrt()
    return shading + scale * torch.randn(shading.shape, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize("noise", [1e-4, 0.01, 0.1])
def test_the_optimum_is_proven_by_its_multipliers(operator, noise):
    shading = noisy(operator @ lamps(6), noise)
    # lights that want to be negative: nothing but a dark spot explains them
    shading = torch.cat([shading, -shading[:, :1], operator @ -lamps(1, 9)], dim=1)
    fit = nonnegative_harmonics(operator, shading, noise=noise)
    light = TABLE @ fit.coefficients
    size = float((operator.T @ shading).abs().max())
    residual = operator.T @ (operator @ fit.coefficients - shading) + fit.ridge * fit.coefficients
    torch.testing.assert_close(residual, TABLE.T @ fit.multipliers, atol=1e-9 * size, rtol=0)
    assert float(light.min()) > -1e-9 * float(light.max())
    assert float(fit.multipliers.min()) >= 0
    assert float((fit.multipliers * light).abs().max()) < 1e-9 * size * float(light.max())
    assert bool((fit.multipliers > 0).any())


def test_agrees_with_a_general_solver(operator):
    shading = noisy(operator @ lamps(1), 0.05)[:, 0]
    fit = nonnegative_harmonics(operator, shading[:, None], noise=0.05)
    a, s = operator.numpy(), shading.numpy()
    hessian = a.T @ a + fit.ridge * torch.eye(25).double().numpy()

    def value(c) -> float:
        return 0.5 * c @ hessian @ c - c @ (a.T @ s)

    found = minimize(
        value,
        torch.eye(25).double()[0].numpy(),
        jac=lambda c: hessian @ c - a.T @ s,
        method="SLSQP",
        constraints=[LinearConstraint(TABLE.numpy(), 0)],
        options={"maxiter": 500, "ftol": 1e-14},
    )
    mine = fit.coefficients[:, 0]
    assert value(mine.numpy()) <= found.fun + 1e-8 * abs(found.fun)
    torch.testing.assert_close(mine, torch.from_numpy(found.x), atol=1e-3, rtol=1e-3)


def test_constraints_that_do_not_bind_change_nothing(operator):
    """A grey light and a little more: plain least squares with the stated ridge."""
    coefficients = 0.1 * torch.randn(25, 2, generator=torch.Generator().manual_seed(0)).double()
    coefficients[0] = math.sqrt(4 * math.pi) * 2
    shading = operator @ coefficients
    fit = nonnegative_harmonics(operator, shading, noise=1e-3)
    ridge = 1e-6 * operator.square().sum() / len(operator)
    system = operator.T @ operator + ridge * torch.eye(25)
    torch.testing.assert_close(fit.coefficients, torch.linalg.solve(system, operator.T @ shading))
    assert not bool(fit.multipliers.any())


def test_knowing_that_light_is_not_negative_helps_against_noise(operator):
    truth = lamps(30, seed=2)
    shading = noisy(operator @ truth, 0.02)
    fit = nonnegative_harmonics(operator, shading, noise=0.02)
    system = operator.T @ operator + fit.ridge * torch.eye(25)
    free = torch.linalg.solve(system, operator.T @ shading)
    mine, theirs = (fit.coefficients - truth).norm(dim=0), (free - truth).norm(dim=0)
    assert float(mine.mean()) < 0.8 * float(theirs.mean())
    # the plain fit is indeed negative where it should not be
    table = harmonics.evaluate(FINE.directions, 4)
    assert float(((table @ free).amin(0) / (table @ free).amax(0)).mean()) < -0.02


def deepest_dip(degree: int, constraints: DirectionGrid) -> float:
    """How far below 0 a light that is >= 0 at the constraints may fall, as a share of its range.

    On a great circle the light is a trigonometric polynomial p of degree n with
    ``|p''| <= n^2 (max - min) / 2`` (Bernstein). From its lowest place, where p' = 0, the nearest
    constraint is at most h away, so that ``min >= -(n h)^2 / 4 (max - min)``.
    """
    fine = DirectionGrid.latlong(256).directions
    cosine = torch.cat([(part @ constraints.directions.T).amax(1) for part in fine.split(8192)])
    # half a pixel's diagonal: no direction is further from the fine grid
    radius = float(torch.arccos(cosine.clamp(max=1)).max()) + math.pi / 256 / math.sqrt(2)
    return (degree * radius) ** 2 / 4


def test_between_constraints_light_hardly_dips(operator):
    fit = nonnegative_harmonics(operator, noisy(operator @ lamps(30, seed=3), 0.05), noise=0.05)
    light = fit.radiance(FINE)
    dip = -(light.amin(0) / (light.amax(0) - light.amin(0)))
    assert float(dip.max()) < deepest_dip(4, CONSTRAINTS) < 0.05
    assert 0 < float(dip.max()) < 0.01


def test_the_bound_of_dips_holds_for_few_constraints(operator):
    few = DirectionGrid.hammersley(100)
    shading = noisy(operator @ lamps(30, seed=3), 0.05)
    light = nonnegative_harmonics(operator, shading, noise=0.05, constraints=few).radiance(FINE)
    dip = -(light.amin(0) / (light.amax(0) - light.amin(0)))
    assert 0.005 < float(dip.max()) < deepest_dip(4, few)


def test_brightness_scales(operator):
    shading = noisy(operator @ lamps(2), 0.05)
    one = nonnegative_harmonics(operator, shading, noise=0.05)
    many = nonnegative_harmonics(operator, 1e4 * shading, noise=0.05)
    torch.testing.assert_close(many.coefficients, 1e4 * one.coefficients, atol=1e-6, rtol=1e-8)


def test_black_is_black(operator):
    fit = nonnegative_harmonics(operator, torch.zeros(80, 1, dtype=torch.float64))
    assert not bool(fit.coefficients.any())
    assert fit.degree == 4


def test_refusals(operator):
    with pytest.raises(InputError, match="apart"):
        nonnegative_harmonics(operator[:9], torch.ones(9, 1), noise=0.0)
    with pytest.raises(InputError, match="NaN"):
        nonnegative_harmonics(operator, torch.full((80, 1), torch.nan))
