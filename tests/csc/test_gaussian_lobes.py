import math
import pickle

import pytest
import torch
from scipy.special import exp1
from torch.func import grad

from skylight.csc import _dictionary as dictionary
from skylight.csc._dictionary import FilterBank
from skylight.csc._gaussian_lobes import GaussianLobes, fitted_lobes
from skylight.sphere import _lobes as lobes
from skylight.sphere._frame import DirectionGrid, direction_from_angles
from skylight.sphere._rotation import matrix_from_euler

F64 = torch.float64


def at_the_zenith(precisions: list[list[float]]) -> GaussianLobes:
    """u towards +Z and v towards +X, as filters lie about the zenith."""
    axes = torch.tensor([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]], dtype=F64)
    table = torch.tensor(precisions, dtype=F64)
    return GaussianLobes(axes=axes[:, None].expand(3, len(table), 3), precisions=table)


def test_the_integral_of_a_round_lobe_is_an_exponential_integral() -> None:
    """Z = 4 pi (1 - p e^p E_1(p))."""
    p = torch.tensor([0.01, 1.0, 4.0, 50.0, 300.0], dtype=F64)
    expected = 4 * math.pi * (1 - p * torch.exp(p) * torch.from_numpy(exp1(p.numpy())))
    found = at_the_zenith(torch.stack([p, p], 1).tolist()).normaliser
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=0)


def test_densities_and_moments_are_those_of_the_lobes_on_a_grid() -> None:
    a1, a2 = torch.tensor([0.0, 0.5, 0.5, 2.0, 6.0]), torch.tensor([0.0, 0.7, 4.0, 2.0, 9.0])
    drawn = at_the_zenith((4 * torch.stack([a1, a2], 1) ** 2).tolist())
    grid = DirectionGrid.latlong(256)
    x, y, z = grid.directions.unbind(1)
    theta, phi = torch.acos(y.clamp(-1, 1)), torch.atan2(x, z)
    shape = (theta[:, None], phi[:, None], a1.double(), a2.double())
    values = lobes.anisotropic_gaussian(*shape)
    expected = values / (grid.solid_angles @ values)
    density = drawn.density(grid.directions)
    torch.testing.assert_close(density, expected, rtol=1e-3, atol=1e-4 * float(density.max()))
    weight = density * grid.solid_angles[:, None]
    mean, variance = drawn.moments()
    torch.testing.assert_close(mean, y @ weight, rtol=0, atol=2e-3)
    second = torch.stack([z**2 @ weight, x**2 @ weight, y**2 @ weight - mean**2], 1)
    torch.testing.assert_close(variance, second, rtol=0, atol=2e-3)


def test_shares_of_proposals_that_are_accepted() -> None:
    """As :meth:`GaussianLobes.draw` says."""
    steps = torch.logspace(-4, 4, 33, dtype=F64)
    p, q = (each.flatten() for each in torch.meshgrid(steps, steps, indexing="ij"))
    z = at_the_zenith(torch.stack([p, q], 1).tolist()).normaliser / (4 * math.pi)
    share = torch.where(p * q < 1, z, z * torch.sqrt(p * q))
    assert share.max() <= 1
    usual = (p == q) | ((p >= 1) & (q >= 1))
    assert share[usual].min() == pytest.approx(1 - math.e * float(exp1(1.0)), abs=1e-9)
    assert share[(q < 401 * p) & (p < 401 * q)].min() > 0.19


def test_draws_have_the_moments_of_their_lobes() -> None:
    """Wide, round, long and sharp ones, to 5 standard errors of 20,000 draws."""
    drawn = at_the_zenith([[0, 0], [0.3, 0.3], [1, 60], [20, 20], [1000, 2000]])
    count = 20_000
    which = torch.arange(5).repeat_interleave(count)
    found = drawn.draw(which, torch.Generator().manual_seed(0)).view(5, count, 3)
    assert (found.norm(dim=2) - 1).abs().max() < 1e-12
    mean, variance = drawn.moments()
    second = torch.stack([variance[:, 1], variance[:, 2] + mean**2, variance[:, 0]], 1)
    error = found.square().var(1).sqrt() / math.sqrt(count)
    assert ((found.square().mean(1) - second).abs() < 5 * error).all()
    assert ((found[..., 1].mean(1) - mean).abs() < 5 * (variance[:, 2] / count).sqrt() + 1e-6).all()


def test_filters_are_fitted_by_what_they_were_made_of() -> None:
    pairs = torch.tensor([[0.5, 0.5], [0.5, 3.0], [2.0, 4.0], [5.0, 5.0]], dtype=F64)
    a1, a2 = pairs[:, 0, None, None], pairs[:, 1, None, None]
    bank = FilterBank.project(
        lambda theta, phi: lobes.anisotropic_gaussian(theta, phi - 0.4, a1, a2), 40, "turned"
    )
    precisions, longitudes = fitted_lobes(bank, torch.tensor([3, 1, 2, 0, 1]))
    torch.testing.assert_close(precisions, 4 * pairs[[3, 1, 2, 0, 1]] ** 2, rtol=2e-3, atol=0)
    long = longitudes[[1, 2, 4]]
    torch.testing.assert_close(torch.sin(long - 0.4), torch.zeros(3, dtype=F64), rtol=0, atol=1e-3)


def test_a_von_mises_fisher_lobe_is_met_to_half_a_percent_of_its_height() -> None:
    bank = dictionary.von_mises_fisher()
    precisions, _ = fitted_lobes(bank, torch.tensor([1]))
    theta = torch.linspace(0, math.pi, 400, dtype=F64)
    density = at_the_zenith(precisions.tolist()).density(
        direction_from_angles(torch.zeros_like(theta), theta)
    )[:, 0]
    expected = lobes.von_mises_fisher(theta, torch.tensor(80.0, dtype=F64))
    assert (density / density[0] - expected).abs().max() < 5e-3


def test_the_constant_and_what_has_no_peak_at_the_pole_are_uniform() -> None:
    hollow = -dictionary.isotropic(10, 4).coefficients[3:4]
    bank = FilterBank(torch.cat([dictionary.isotropic(10, 4).coefficients[:1], hollow]), "flat")
    precisions, longitudes = fitted_lobes(bank, torch.tensor([0, 1]))
    assert precisions.tolist() == [[0, 0], [0, 0]]
    assert longitudes.isfinite().all()


def test_lobes_turn_with_their_axes() -> None:
    angles = torch.tensor([0.3, 1.2, -0.7], dtype=F64)
    turn = matrix_from_euler(*angles)
    still = at_the_zenith([[2, 30]])
    moved = GaussianLobes(axes=still.axes @ turn.T, precisions=still.precisions)
    directions = DirectionGrid.latlong(8).directions
    torch.testing.assert_close(moved.density(directions @ turn.T), still.density(directions))


def test_who_asks_first_leaves_nothing_that_others_cannot_use() -> None:
    """Inference mode and transforms may come before gradients and pickles."""
    drawn, directions = (
        at_the_zenith([[1.0, 4.0], [9.0, 25.0]]),
        DirectionGrid.latlong(4).directions,
    )
    expected = at_the_zenith([[1.0, 4.0], [9.0, 25.0]]).density(directions)
    with torch.inference_mode():
        drawn.density(directions)
    grad(lambda at: drawn.density(at).sum())(directions)
    pickle.dumps(drawn)
    moved = directions.clone().requires_grad_()
    assert torch.autograd.grad(drawn.density(moved).sum(), moved)[0].isfinite().all()
    assert torch.equal(drawn.density(directions), expected)
