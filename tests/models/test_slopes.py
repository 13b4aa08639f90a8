"""Derivatives of lamped lights in closed form: those of automatic differentiation."""

import math

import pytest
import torch

from skylight.models._base import Prior, without_azimuth
from skylight.models._lamps import LampsLight, LampsPrior
from skylight.models._prior import GaussianMixture, convex
from skylight.models._sphere import SphereLight, SpherePrior, row_turns
from tests.models.test_sphere import small_places


@pytest.mark.parametrize("count", [0, 1, 3])
@pytest.mark.parametrize("kind", ["sphere", "lamps"])
def test_slopes_are_those_of_automatic_differentiation(kind: str, count: int) -> None:
    light = SphereLight(count, 8, small_places()) if kind == "sphere" else LampsLight(count, 8)
    light = light.double()
    generator = torch.Generator().manual_seed(count)
    params = torch.randn(2, light.parameter_count, generator=generator).double()
    found = light.slopes(params)
    each = [torch.autograd.functional.jacobian(light, one) for one in params]
    torch.testing.assert_close(found, torch.stack(each).permute(0, 3, 1, 2), rtol=1e-6, atol=1e-7)


def test_what_is_cut_off_has_no_slope() -> None:
    """Lamps beyond the widest, and ambient light beyond what is computed."""
    light = LampsLight(1, 8).double()
    params = torch.zeros(1, light.parameter_count).double()
    params[:, :2], params[:, 16:] = 1e3, torch.tensor([0.0, 1, 0, 0, 6, 0, 0])
    found = light.slopes(params)
    assert float(found[:, :2].abs().max()) == float(found[:, 20].abs().max()) == 0
    assert float(found[:, 19].abs().max()) > 0


def test_rows_turn_as_waves_do() -> None:
    turn, width = torch.tensor([0.3, 2 * math.pi / 8], dtype=torch.float64), 8
    angle = 2 * math.pi * torch.arange(width).double() / width
    wave = torch.cos(3 * angle)
    turned = wave @ row_turns(turn, width)
    torch.testing.assert_close(turned[0], torch.cos(3 * (angle - 0.3)))
    torch.testing.assert_close(turned[1], wave.roll(1), rtol=0, atol=1e-14)
    slope = wave @ row_turns(turn, width, slope=True)
    torch.testing.assert_close(slope[0], 3 * torch.sin(3 * (angle - 0.3)))


def test_autocast_takes_no_digits() -> None:
    light, prior = SphereLight(1, 8, small_places()), SpherePrior(1, small_places())
    params = torch.randn(2, light.parameter_count, generator=torch.Generator().manual_seed(6))
    free = without_azimuth(light, params)
    exact = light.slopes(params), *prior.convex_shape(free)
    with torch.autocast("cpu", torch.bfloat16):
        found = light.slopes(params), *prior.convex_shape(free)
    for one, other in zip(found, exact, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0)


def test_what_is_above_a_prior_touches_it() -> None:
    """``-log_prob(y) <= -log_prob(x) + s (y - x) + (y - x) C (y - x) / 2``, and s its slope."""
    prior = SpherePrior(0, small_places()).double()
    x, y = 2 * torch.randn(2, 50, 2, generator=torch.Generator().manual_seed(0)).double()
    slope, curvature = prior.convex_shape(x)
    off = y - x
    above = (slope * off).sum(1) + 0.5 * torch.einsum("bp,bpq,bq->b", off, curvature, off)
    assert bool((-prior.log_prob(y) <= -prior.log_prob(x) + above + 1e-9).all())
    torch.testing.assert_close(slope, slope_of(prior, x))


def test_of_one_component_that_is_the_hessian() -> None:
    """In one kind of place that has one component, but for what lamps bend the other way."""
    prior = SpherePrior(2, small_places(), {"field": -math.inf}).double()
    x = prior.sample(3, torch.Generator().manual_seed(0))
    slope, curvature = prior.convex_shape(x)
    torch.testing.assert_close(slope, slope_of(prior, x))
    for one, found in zip(x, curvature, strict=True):
        exact = torch.autograd.functional.hessian(lambda at: -prior.log_prob(at), one)
        values, vectors = torch.linalg.eigh(exact)
        convex = vectors @ (values.clamp(min=0)[:, None] * vectors.T)
        torch.testing.assert_close(found, convex, rtol=1e-4, atol=1e-4)


def slope_of(prior: Prior, x: torch.Tensor) -> torch.Tensor:
    leaf = x.clone().requires_grad_()
    return torch.autograd.grad(-prior.log_prob(leaf).sum(), leaf)[0]


def test_a_mixture_bends_as_automatic_differentiation_says() -> None:
    """Between its components, where it is concave, and far away."""
    factors = torch.eye(3).repeat(2, 1, 1) * torch.tensor([1.0, 3.0])[:, None, None]
    means = torch.tensor([[0.0, 0, 0], [1.5, -1, 0.5]])
    mixture = GaussianMixture(torch.tensor([0.3, 0.7]), means, factors).double()
    x = torch.cat([means.mean(0)[None], torch.randn(4, 3), torch.full((1, 3), 300.0)]).double()
    slope, hessian = mixture.shape(x)
    torch.testing.assert_close(slope, slope_of(mixture, x))
    for one, found in zip(x, hessian, strict=True):
        exact = torch.autograd.functional.hessian(lambda at: -mixture.log_prob(at), one)
        torch.testing.assert_close(found, exact)


@pytest.mark.parametrize("count", [0, 2])
def test_lamps_in_even_light_bend_as_automatic_differentiation_says(count: int) -> None:
    prior = LampsPrior(count).double()
    x = prior.sample(5, torch.Generator().manual_seed(count))
    x = x + 0.3 * torch.randn(x.shape, generator=torch.Generator().manual_seed(3)).double()
    slope, hessian = prior.convex_shape(x)
    torch.testing.assert_close(slope, slope_of(prior, x))
    for one, found in zip(x, hessian, strict=True):
        exact = torch.autograd.functional.hessian(lambda at: -prior.log_prob(at), one)
        torch.testing.assert_close(found, convex(exact))
