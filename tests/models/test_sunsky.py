import math

import pytest
import torch
from hypothesis import given, settings, strategies as st

from skylight.models.sunsky import KAPPA_BOUNDS, TURBIDITY_BOUNDS, SunSky, fit_sunsky, perez
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import angle_between, direction_from_angles

F64 = torch.float64
MODEL = SunSky()


def f64(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=F64)


def params(
    *, sky: float = 1.0, sun: float = 1.0, azimuth: float = 0.3, zenith: float = 0.8,
    turbidity: float = 3.0, kappa: float = 500.0,
) -> torch.Tensor:  # fmt: skip
    return f64(sky, 0.9 * sky, 0.8 * sky, sun, 0.9 * sun, 0.8 * sun, azimuth, zenith, turbidity,
               kappa)[None]  # fmt: skip


@pytest.mark.parametrize(
    ("turbidity", "sun_zenith_deg", "ratio"),
    [(2.17, 45, 1.4962), (2.5, 30, 0.9264), (3, 60, 1.4524), (6, 45, 0.8411)],
)
def test_perez_distribution(turbidity: float, sun_zenith_deg: float, ratio: float) -> None:
    """Luminance 60 degrees from zenith and sun over that of the zenith, computed from
    ebruneton/clear-sky-models' formula."""
    t, sun, sixty = f64(turbidity), f64(math.radians(sun_zenith_deg)), f64(math.pi / 3)
    aside, up = perez(torch.cos(sixty), sixty, t), perez(f64(1.0), sun, t)
    assert (aside / up).item() == pytest.approx(ratio, abs=5.1e-5)


@given(st.floats(*TURBIDITY_BOUNDS), st.floats(0, math.pi / 2), st.floats(0, math.pi))
def test_perez_is_positive_for_all_parameters(t: float, theta: float, gamma: float) -> None:
    assert perez(torch.cos(f64(theta)), f64(gamma), f64(t)).item() > 0


zeniths = st.floats(0, math.pi / 2)
azimuths = st.floats(-4, 4)
turbidities = st.floats(*TURBIDITY_BOUNDS)
kappas = st.floats(*KAPPA_BOUNDS)


@settings(deadline=None)
@given(azimuths, zeniths, turbidities)
def test_sky_weight_is_its_mean_radiance(azimuth: float, zenith: float, t: float) -> None:
    light = MODEL(params(sun=0, azimuth=azimuth, zenith=zenith, turbidity=t))[0]
    mean = MODEL.grid.solid_angles @ light / (2 * math.pi)
    torch.testing.assert_close(mean, f64(1, 0.9, 0.8), rtol=1e-12, atol=0)


@settings(deadline=None)
@given(azimuths, zeniths, kappas)
def test_sun_energy_is_exact_between_pixels_too(azimuth: float, zenith: float, k: float) -> None:
    """Over both hemispheres: the lobe above plus that of the mirrored grid below."""
    sun = direction_from_angles(f64(azimuth), f64(zenith))
    solid_angles = MODEL.grid.solid_angles
    above = MODEL.sun_lobe(sun, f64(k))[0] @ solid_angles
    below = MODEL.sun_lobe(sun * f64(1, -1, 1), f64(k))[0] @ solid_angles
    assert (above + below).item() == pytest.approx(1, rel=1e-12)


@pytest.mark.parametrize(("kappa", "tolerance"), [(8, 1e-3), (50, 1e-3), (400, 0.01)])
def test_lobe_is_the_analytic_one_where_pixels_resolve_it(kappa: float, tolerance: float) -> None:
    sun = direction_from_angles(f64(0.4), f64(0.9))
    constant = kappa / (2 * math.pi * (1 - math.exp(-2 * kappa)))
    analytic = constant * torch.exp(kappa * (MODEL.grid.directions @ sun[0] - 1))
    lobe = MODEL.sun_lobe(sun, f64(kappa))[0]
    torch.testing.assert_close(lobe, analytic, rtol=tolerance, atol=0)


@pytest.mark.parametrize("zenith", [0.0, math.pi / 2])
@pytest.mark.parametrize("turbidity", [1.7, 35.0])
@pytest.mark.parametrize("kappa", [8.0, 8192.0])
@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_value_and_gradients_at_the_corners(
    zenith: float, turbidity: float, kappa: float, dtype: torch.dtype
) -> None:
    p = params(zenith=zenith, turbidity=turbidity, kappa=kappa).to(dtype).requires_grad_()
    light = MODEL(p)
    assert light.isfinite().all()
    (gradient,) = torch.autograd.grad((light**2).sum(), p)
    assert gradient.isfinite().all()


def test_gradients_with_the_sun_on_a_pixel_centre() -> None:
    """gamma = 0 there, where arccos has an infinite slope."""
    p = params(zenith=(10 + 0.5) * math.pi / 64, azimuth=math.pi / 128).requires_grad_()
    gamma = angle_between(
        MODEL.grid.directions, direction_from_angles(p[:, 6], p[:, 7]).expand(4096, 3)
    )
    assert gamma.min() < 1e-7
    (gradient,) = torch.autograd.grad(MODEL(p).sum(), p)
    assert gradient.isfinite().all()


def test_start_weathers_have_a_mean_luminance_of_about_one() -> None:
    light = MODEL(MODEL.starts().double())
    mean = luminance(light) @ MODEL.grid.solid_angles / (2 * math.pi)
    torch.testing.assert_close(mean, torch.ones_like(mean), atol=1e-3, rtol=0)


def test_fit_recovers_the_parameters_of_its_own_skies() -> None:
    true = torch.cat(
        [
            params(sky=0.3, sun=4.5, zenith=0.7, turbidity=2.5, kappa=4000),
            params(sky=0.6, sun=2.0, azimuth=-2.0, zenith=1.2, turbidity=6, kappa=300),
            params(sky=0.4, sun=3.5, azimuth=3.1, zenith=0.4, turbidity=4, kappa=60),
        ]
    )
    sky = MODEL(true)
    found = fit_sunsky(sky, MODEL)
    angle = angle_between(
        direction_from_angles(true[:, 6], true[:, 7]),
        direction_from_angles(found[:, 6], found[:, 7]),
    )
    assert torch.rad2deg(angle).max() < 1.5
    torch.testing.assert_close(found[:, :3], true[:, :3], rtol=0.05, atol=0)
    torch.testing.assert_close(found[:, 3:6], true[:, 3:6], rtol=0.05, atol=0)
    torch.testing.assert_close(found[:, 8].log(), true[:, 8].log(), atol=0.3, rtol=0)
    torch.testing.assert_close(found[:, 9].log(), true[:, 9].log(), atol=0.5, rtol=0)


def test_fit_keeps_the_energy_of_any_sky() -> None:
    sky = torch.rand(3, 4096, 3, generator=torch.Generator().manual_seed(0), dtype=F64)
    sky[1] *= 1e4
    found = fit_sunsky(sky, MODEL)
    low, high = MODEL.bounds
    assert ((found >= low) & (found <= high)).all()
    solid_angles = MODEL.grid.solid_angles
    energy = torch.einsum("n,bnc->bc", solid_angles, MODEL(found))
    torch.testing.assert_close(
        energy, torch.einsum("n,bnc->bc", solid_angles, sky), rtol=1e-3, atol=0
    )


def test_fit_of_darkness_is_finite() -> None:
    found = fit_sunsky(torch.zeros(1, 4096, 3), MODEL)
    assert found.isfinite().all()
    assert MODEL(found).max() < 1e-6
