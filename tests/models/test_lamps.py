"""Lamps in ambient light: energies, the ambient light's mean, and a prior that is a density."""

import math

import pytest
import torch

from skylight.models._lamps import (
    AMBIENT_PARAMETERS,
    AMBIENT_SPREADS,
    LAMP_HEIGHT,
    UPWARD,
    LampsLight,
    LampsPrior,
)
from skylight.sphere._envmap import luminance

GENERATOR = 7


def drawn(count, number=2):
    generator = torch.Generator().manual_seed(GENERATOR)
    return LampsPrior(number).sample(count, generator).double()


@pytest.mark.parametrize("height", [16, 32, 64])
def test_energies_are_those_of_the_lamps_and_the_ambient_light_on_every_grid(height):
    model, params = LampsLight(2, height), drawn(5)
    weight = model.grid.solid_angles
    torch.testing.assert_close(
        luminance(model.ambient(params)) @ weight, torch.full((5,), 4 * math.pi).double()
    )
    lamps = model.lamps(params)
    whole = luminance(model(params)) @ weight
    torch.testing.assert_close(whole, 4 * math.pi * (1 + lamps.energies.sum(1)))
    torch.testing.assert_close(luminance(lamps.colours), torch.ones(5, 2).double())


def test_a_lobe_is_centred_on_its_direction_and_as_wide_as_it_says():
    model = LampsLight(1, 64)
    params = model.starts_towards(torch.tensor([[0.3, 0.5, 0.8]]))[0, 1:2].double()
    lamps = model.lamps(params)
    lobe = model.lobes(lamps)[0, 0] * model.grid.solid_angles
    centre = lobe @ model.grid.directions
    towards = lamps.directions[0, 0]
    assert math.degrees(math.acos(float(centre / centre.norm() @ towards))) < 0.2
    # the mean resultant length of a von Mises-Fisher density is coth(kappa) - 1 / kappa
    kappa = 1 / float(lamps.widths_rad) ** 2
    assert float(centre.norm()) == pytest.approx(1 / math.tanh(kappa) - 1 / kappa, rel=2e-3)


def test_ambient_light_varies_as_the_prior_says():
    model, params = LampsLight(0, 16), drawn(2000, 0)
    level = model.ambient(params)[..., 1].log()
    share = model.grid.solid_angles / (4 * math.pi)
    level = level - (level @ share)[:, None]
    field = level.var(0, correction=0) @ share + level.mean(0).square() @ share
    expected = AMBIENT_SPREADS[0] ** 2 + AMBIENT_SPREADS[1] ** 2 + UPWARD**2 / 3
    # green has a part of luminance, not all: no chroma in it
    assert float(field) == pytest.approx(expected, rel=0.05)
    up = model.grid.directions[:, 1]
    slope = float((level.mean(0) * up) @ share * 3)
    assert slope == pytest.approx(UPWARD, abs=0.05)


def test_the_prior_is_a_density_that_its_draws_have():
    """E[1 / p] over draws within a box is the box's volume; heights have their mean."""
    prior, generator = LampsPrior(1), torch.Generator().manual_seed(1)
    x = prior.sample(200_000, generator).double()
    direction = x[:, AMBIENT_PARAMETERS : AMBIENT_PARAMETERS + 3]
    up = direction[:, 1] / direction.norm(dim=1)
    assert float(up.mean()) == pytest.approx(1 / math.tanh(LAMP_HEIGHT) - 1 / LAMP_HEIGHT, abs=0.01)
    # of the direction alone, the rest at its mean
    at_mean = torch.zeros_like(x)
    at_mean[:, AMBIENT_PARAMETERS : AMBIENT_PARAMETERS + 3] = direction
    rest = x.shape[1] - 3
    log_direction = prior.log_prob(at_mean) + 0.5 * rest * math.log(2 * math.pi)
    length = direction.norm(dim=1)
    shell = (length - 1).abs() < 0.1
    volume = float((shell / log_direction.exp()).mean())
    assert volume == pytest.approx(4 / 3 * math.pi * (1.1**3 - 0.9**3), rel=0.03)


def test_a_negative_number_of_lamps_is_refused():
    with pytest.raises(ValueError, match="-1 lamps: give 0 or more"):
        LampsLight(-1)


@pytest.mark.parametrize("width_deg", [3, 8, 20, 40])
def test_irradiance_of_a_surface_that_faces_a_lamp(width_deg):
    width = torch.tensor(math.radians(width_deg), dtype=torch.float64)
    cosine = torch.linspace(-1, 1, 400_001, dtype=torch.float64)
    lobe = torch.exp((cosine - 1) / width**2)
    expected = (lobe * cosine.clamp(min=0)).sum() / lobe.sum()
    torch.testing.assert_close(LampsLight.facing(width), expected, rtol=1e-4, atol=0)
