import math

import pytest
import torch
from scipy.integrate import quad

from skylight.sphere import _lobes as lobes

F64 = torch.float64


def column(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=F64)[:, None]


@pytest.mark.parametrize("kappa", [0.5, 80.0, 3000.0])
def test_integral_of_von_mises_fisher_is_that_of_its_density(kappa: float) -> None:
    """2 pi (1 - exp(-2 kappa)) / kappa over the sphere."""

    def ring(theta: float) -> float:
        value = lobes.von_mises_fisher(torch.tensor(theta, dtype=F64), torch.tensor(kappa).to(F64))
        return 2 * math.pi * math.sin(theta) * float(value)

    near = min(math.pi, 10 / math.sqrt(kappa))
    total = quad(ring, 0, near)[0] + quad(ring, near, math.pi)[0]
    assert total == pytest.approx(2 * math.pi * -math.expm1(-2 * kappa) / kappa, rel=1e-9)


def test_gaussian_is_the_plane_one_of_the_stereographic_radius() -> None:
    """r = 2 tan(theta / 2) is the radius; at r = 1 / a the lobe has 1 / e of its height."""
    a = column(0.3, 2.0, 14.33)
    theta = 2 * torch.atan(1 / (2 * a))
    torch.testing.assert_close(
        lobes.gaussian(theta, a), torch.full((3, 1), math.exp(-1), dtype=F64)
    )


def test_equal_widths_are_the_isotropic_gaussian() -> None:
    theta, phi = torch.rand(2, 1, 50, generator=torch.Generator().manual_seed(0), dtype=F64)
    theta, phi = theta * math.pi, phi * 2 * math.pi
    a = column(0.2, 1.0, 9.0)
    torch.testing.assert_close(
        lobes.anisotropic_gaussian(theta, phi, a, a), lobes.gaussian(theta, a)
    )


def test_anisotropic_is_each_width_along_its_axis() -> None:
    theta = torch.linspace(0, 3, 40, dtype=F64)[None]
    narrow, wide = column(7.0), column(0.8)
    for phi, a in ((0.0, wide), (math.pi / 2, narrow), (math.pi, wide), (-math.pi / 2, narrow)):
        value = lobes.anisotropic_gaussian(theta, torch.full_like(theta, phi), wide, narrow)
        torch.testing.assert_close(value, lobes.gaussian(theta, a))


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_poles_have_their_limits(dtype: torch.dtype) -> None:
    ends = torch.tensor([0, math.pi], dtype=dtype)
    one, zero = torch.ones(2, dtype=dtype), torch.zeros(2, dtype=dtype)
    lobe = torch.tensor([1, 0], dtype=dtype)
    assert torch.equal(lobes.gaussian(ends, one / 50), lobe)
    assert torch.equal(lobes.gaussian(ends, zero), one)
    assert torch.equal(lobes.anisotropic_gaussian(ends, one, one / 50, one), lobe)
    assert torch.equal(lobes.von_mises_fisher(ends, 1000 * one), lobe)


def test_gradients_are_finite_at_the_poles() -> None:
    theta = torch.tensor([0, 1, math.pi], dtype=F64, requires_grad=True)
    a = torch.tensor(2, dtype=F64, requires_grad=True)
    value = lobes.anisotropic_gaussian(theta, torch.ones_like(theta), a, 2 * a)
    (value + lobes.von_mises_fisher(theta, a)).sum().backward()
    assert theta.grad is not None
    assert a.grad is not None
    assert theta.grad.isfinite().all()
    assert a.grad.isfinite()
