"""The common loss of the fits, and the descent under it."""

import math

import pytest
import torch

from skylight.evaluation._sky_fits import (
    LossWeights,
    SkyLoss,
    autoencoder_start,
    descend,
    fit_harmonic,
    fit_sun_and_sky,
    over_ground,
    sun_and_sky_start,
)
from skylight.models._bundle import load_bundle
from skylight.models.sunsky import SunSky
from skylight.skies._index import centre_column_azimuth
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, angle_between

FLOOR = 1e-3 * (1 + 1 + LossWeights().shading)  # Charbonnier's, as often as the weights say
SHADING_ONLY = LossWeights(radiance=0.0, log=0.0, shading=1.0)


@pytest.fixture(scope="module")
def sky():
    model = SunSky()
    params = model.starts()[:1]
    params[:, 6] = centre_column_azimuth(32)
    return model(params)[0].reshape(*model.grid.layout, 3)


def test_harmonics_fit_constant_light_exactly():
    # over a white ground a sky of 1 is a sphere of 1
    fit = fit_harmonic(torch.ones(32, 128, 3), torch.ones(3), degree=2)
    torch.testing.assert_close(fit.radiance, torch.ones(64, 128, 3), atol=1e-4, rtol=0)


def test_harmonics_are_cut_at_zero():
    """One bright pixel rings below zero, which light cannot be."""
    sky = torch.full((32, 128, 3), 0.1)
    sky[5, 64] = 1000.0
    fit = fit_harmonic(sky, torch.zeros(3), degree=4).radiance
    assert float(fit.min()) == 0
    assert float((fit == 0).double().mean()) > 0.2
    assert EnvironmentMap(radiance=fit).layout == (64, 128)


def test_ground_is_what_it_sends_back_of_an_even_sky():
    """E = pi L under a sky of L: the ground's radiance is its albedo times L."""
    albedo = torch.tensor([0.1, 0.4, 0.9])
    full = over_ground(torch.full((32, 128, 3), 2.0), albedo).radiance
    assert torch.equal(full[:32], torch.full((32, 128, 3), 2.0))
    torch.testing.assert_close(full[32:], (2 * albedo).expand(32, 128, 3), rtol=1e-4, atol=0)


def test_the_loss_is_least_at_the_sky_itself():
    model = SunSky()
    params = model.starts()[:3]
    sky = model(params)[0].reshape(*model.grid.layout, 3)
    losses = SkyLoss(model, sky)(model.to_free(params), torch.arange(3))
    assert int(losses.argmin()) == 0
    assert float(losses[0]) == pytest.approx(FLOOR, rel=1e-3)


def test_shading_is_the_irradiance_over_pi(sky):
    loss = SkyLoss(SunSky(), sky, SHADING_ONLY)
    normals = DirectionGrid.hammersley(len(loss.transfer)).directions
    environment = EnvironmentMap(radiance=sky)
    for index in (0, 40, 100):
        expected = environment.irradiance(normals[index]) / math.pi
        assert loss.lit[index].tolist() == pytest.approx(expected.tolist(), rel=1e-4)


def test_shading_misses_energy_that_is_nowhere_missed_much(sky):
    """A map a tenth too dark everywhere, against one with the same L1 error that is only noisy."""
    error = 0.1 * sky.reshape(1, -1, 3)
    signs = torch.ones(1, 4096, 1)
    signs[:, ::2] = -1  # alternating columns: no normal sees it
    flat = sky.reshape(1, -1, 3)
    loss = SkyLoss(SunSky(), sky, LossWeights(radiance=1.0, log=0.0, shading=0.0))
    # the sun covers few pixels, so the alternation is of everything but the sun
    calm = torch.where(flat.amax(-1, keepdim=True) > 20, 0.0, error)
    darker, noisy = flat - calm, flat + signs * calm
    assert float(loss.of_radiance(darker)) == pytest.approx(float(loss.of_radiance(noisy)))
    lit = SkyLoss(SunSky(), sky, SHADING_ONLY)
    assert float(lit.of_radiance(darker)) > 4 * float(lit.of_radiance(noisy))


def test_the_encoder_starts_with_the_sun_ahead(sky):
    light = load_bundle().light()
    start = autoencoder_start(light, sky)
    assert start.shape == (1, 65)
    assert float(start[0, -1]) == pytest.approx(centre_column_azimuth(32))
    with torch.no_grad():
        decoded = light(start).reshape(32, 128, 3)
    brightest = EnvironmentMap(radiance=decoded).brightest_direction()
    truth = EnvironmentMap(radiance=sky).brightest_direction()
    assert float(angle_between(brightest, truth).rad2deg()) < 2


def test_the_closed_form_is_near_a_sky_of_the_model_itself(sky):
    start = sun_and_sky_start(sky)
    assert start.shape == (1, SunSky.parameter_count)
    assert start.dtype == torch.float32
    with torch.no_grad():
        found = EnvironmentMap(radiance=SunSky()(start)[0].reshape(32, 128, 3))
    apart = angle_between(
        found.brightest_direction(), EnvironmentMap(radiance=sky).brightest_direction()
    )
    assert float(apart.rad2deg()) < 2
    fitted = fit_sun_and_sky(sky, torch.full((3,), 0.2))
    assert fitted.layout == (64, 128)
    off = (fitted.radiance[:32] - sky).abs().mean() / sky.mean()
    assert float(off) < 0.1


def test_descent_comes_close_to_a_sky_of_the_model_itself(sky):
    model = SunSky()
    loss = SkyLoss(model, sky)
    start = model.starts()[:1]
    start[:, 6] = centre_column_azimuth(32)
    start[:, :6] *= 1.5  # too bright, too hazy, too blunt
    start[:, 8:] *= torch.tensor([1.5, 0.5])
    with torch.no_grad():
        before = loss.of_radiance(model(start))
        after = loss.of_radiance(descend(loss, start)[None])
    assert float(before) > 1
    assert float(after) < 0.1 * float(before)


def test_descent_gets_past_the_kink_of_the_azimuth():
    """A sharp sun half a column aside: held at first, the azimuth is still found afterwards."""
    model = load_bundle().light()
    column = 2 * math.pi / 128
    truth = torch.cat([model.bank[:1], torch.tensor([[centre_column_azimuth(32)]])], 1)
    with torch.no_grad():
        aside = truth.clone()
        aside[:, -1] += 0.5 * column
        sky = model(aside)[0].reshape(32, 128, 3)
    loss = SkyLoss(model, sky)
    with torch.no_grad():
        before = loss.of_radiance(model(truth))
        after = loss.of_radiance(descend(loss, truth)[None])
    assert float(after) < 0.5 * float(before)
