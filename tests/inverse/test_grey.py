"""Light from pictures without colour: luminance alone is compared, hue is the priors'."""

import math
from dataclasses import replace

import pytest
import torch

from skylight.inverse._descent import Stage
from skylight.inverse._faces import FaceTerm, Level, ObjectiveWeights
from skylight.inverse._problem import solve
from skylight.inverse._sky import SkyProblem, SolverOptions
from skylight.models.sunsky import SunSky
from skylight.sphere._envmap import luminance
from tests.inverse.test_solve import (
    ALBEDO_PRIOR,
    MODES,
    SUNS,
    SUNSKY_PRIOR,
    harmonic_ball,
    solve_harmonic,
    watched,
)

LUMINANCE = torch.tensor([0.2126, 0.7152, 0.0722])  # ITU-R BT.709
FEW = SolverOptions(
    stages=(
        Stage(level=Level(3), starts=4, iterations=15),
        Stage(level=Level(1), starts=2, iterations=10),
        Stage(level=Level(0), starts=1, iterations=10),
    )
)


def without_colour(observation):
    grey = (observation.pixels @ LUMINANCE)[:, None].expand(-1, 3)
    return replace(observation, pixels=grey, grey=True)


@pytest.fixture(scope="module")
def faces():
    observation, world = watched(*SUNS[0])
    return observation, without_colour(observation), world


def test_a_change_of_colour_that_keeps_luminance_costs_nothing(faces):
    term, weights = FaceTerm.of(faces[1]), ObjectiveWeights()
    shading = faces[0].pixels[None]
    generator = torch.Generator().manual_seed(3)
    change = 0.3 * torch.randn(shading.shape, generator=generator)
    change = change - (change @ LUMINANCE)[..., None]  # the weights sum to 1
    torch.testing.assert_close(
        term.deviation(shading), torch.zeros_like(shading), atol=1e-5, rtol=0
    )
    torch.testing.assert_close(
        term.data_term(shading + change, weights), term.data_term(shading, weights)
    )
    coloured = FaceTerm.of(faces[0])
    assert coloured.data_term(shading + change, weights) > 10 * term.data_term(shading, weights)
    # and one of luminance what it costs in colour
    torch.testing.assert_close(
        term.data_term(1.2 * faces[1].pixels[None], weights),
        FaceTerm.of(replace(faces[1], grey=False)).data_term(1.2 * faces[1].pixels[None], weights),
    )


def test_grey_survives_the_pyramid_and_the_device(faces):
    assert faces[1].coarser(2).grey
    assert faces[1].to(torch.device("cpu")).grey
    assert faces[1].on_rows(32).scaled(2.0).grey
    assert not faces[0].coarser(2).grey


def test_a_sky_is_found_from_luminance(faces):
    _, grey, world = faces
    problem = SkyProblem(SunSky(), SUNSKY_PRIOR, ALBEDO_PRIOR, MODES, FEW)
    problem.add(grey)
    found = solve([problem])[0]
    assert math.degrees(math.acos(float(found.sun_direction.double().numpy() @ world.sun))) < 3
    assert found.faces[0].residual < 0.04
    torch.testing.assert_close(found.rendered[:, 0], found.rendered[:, 2])
    # hue is that of skies and skin
    red, _, blue = (found.albedo / luminance(found.albedo)).tolist()
    assert red > 1.05 > 0.95 > blue


@pytest.mark.parametrize("degree", [2, 4])
def test_harmonic_light_of_a_grey_picture_is_neutral(degree):
    model, observation = harmonic_ball(degree)
    grey = without_colour(observation)
    found = solve_harmonic(grey, model)
    light = found.environment.radiance
    torch.testing.assert_close(light[..., 0], light[..., 2])
    torch.testing.assert_close(found.rendered, grey.pixels, rtol=0.05, atol=1e-3)
    red, green, blue = found.albedo.tolist()
    assert red > green > blue
    # luminance of albedo times light is what a coloured picture tells, channel by channel
    coloured = solve_harmonic(observation, model)
    product = luminance(coloured.albedo * coloured.environment.radiance)
    torch.testing.assert_close(
        luminance(found.albedo) * luminance(light), product, rtol=0.05, atol=0.02
    )
