import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st

from skylight.skies._clouds import CLOUD_G, FORWARD, SCALED_G, slab_light, two_lobes
from tests.oracles.slab import photons_below

F64 = torch.float64


@settings(deadline=None, max_examples=30)
@given(
    depth=st.floats(1e-3, 60),
    mu0=st.floats(0.05, 1),
    albedo=st.floats(0, 0.95),
    beam=st.floats(0, 3),
    sky=st.floats(0, 3),
)
def test_the_solution_obeys_its_equations(
    depth: float, mu0: float, albedo: float, beam: float, sky: float
) -> None:
    """Nothing is lost, dJ/dtau follows the flux, and both boundaries hold (float64)."""
    tau = torch.linspace(0, depth, 2001, dtype=F64)
    light = slab_light(tau, depth - tau, mu0, albedo)
    mean = beam * light.beam_mean + sky * light.sky_mean
    flux = beam * light.beam_flux + sky * light.sky_flux
    direct = mu0 * beam * torch.exp(-tau / mu0)
    net = flux + direct
    torch.testing.assert_close(net, net[:1].expand_as(net), rtol=1e-9, atol=1e-9)
    slope = torch.diff(mean) / torch.diff(tau) * 4 * math.pi / 3
    middle = (direct[1:] + direct[:-1]) / 2
    expected = -(1 - SCALED_G) * net[0] + middle
    scale = float(expected.abs().max()) + 1e-6
    step = depth / 2000 / mu0
    assert float((slope - expected).abs().max()) < (1e-6 + step) * scale
    assert float(math.pi * mean[0] + flux[0] / 2) == pytest.approx(sky, abs=1e-9)
    up = math.pi * mean[-1] - flux[-1] / 2
    down = math.pi * mean[-1] + flux[-1] / 2 + direct[-1]
    assert float(up) == pytest.approx(albedo * float(down), abs=1e-9)


@pytest.mark.parametrize("depth", [0.5, 2.0, 5.0, 30.0])
@pytest.mark.parametrize("mu0", [0.1, 0.25, 0.5, 0.9])
def test_light_sent_down_is_that_of_photons(depth: float, mu0: float) -> None:
    """Against Monte Carlo of unscaled Henyey-Greenstein droplets, as a share of what falls in."""
    scaled = torch.tensor((1 - FORWARD) * depth, dtype=F64)
    bottom = slab_light(scaled, 0 * scaled, mu0, 0.0)
    sent = float(bottom.beam_flux) / mu0 + math.exp(-float(scaled) / mu0)
    truth, _ = photons_below(depth, mu0, g=CLOUD_G, count=20_000)
    assert sent == pytest.approx(truth, abs=0.14 if mu0 < 0.5 else 0.05)


def test_phase_function() -> None:
    """Integral 1 and mean cosine g' = g / (1 + g), by Gauss-Legendre quadrature."""
    cosine, weight = np.polynomial.legendre.leggauss(200)
    value = two_lobes(torch.tensor(cosine)).numpy()
    assert 2 * math.pi * float(weight @ value) == pytest.approx(1, abs=1e-9)
    mean = 2 * math.pi * float(weight @ (value * cosine))
    assert mean == pytest.approx(SCALED_G, abs=2e-3)
