import math

import pytest
import torch
from hypothesis import given, settings, strategies as st

from skylight.models._sun_head import COORDINATES, KAPPA_BOUNDS, NEAR_RAD, SunHead
from skylight.skies._atmosphere import ClearSky
from skylight.skies._simulator import draw_day, simulate_sky
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid, angle_between, direction_from_angles
from tests.skies.clear_days import without_clouds

HEIGHT = 32
AZIMUTH = math.pi / (4 * HEIGHT)
GRID = DirectionGrid.sky(HEIGHT)
HEAD = SunHead(HEIGHT, AZIMUTH)


def coordinates(zenith_deg: float, energy: float, kappa: float) -> torch.Tensor:
    """The documented formulae, inverted by hand."""
    height = zenith_deg / 90
    log_kappa = math.log(kappa / KAPPA_BOUNDS[0]) / math.log(KAPPA_BOUNDS[1] / KAPPA_BOUNDS[0])
    strength = (math.log(energy) + 1) / 2
    return torch.tensor(
        [
            math.log(height / (1 - height)) / 1.5,
            *[strength] * 3,
            math.log(log_kappa / (1 - log_kappa)),
        ]
    )[None]


@settings(deadline=None, max_examples=30)
@given(
    zenith_deg=st.floats(1, 89),
    energy=st.floats(0.01, 50),
    kappa=st.floats(210, 29000),
)
def test_a_lobe_has_its_energy_and_its_place(
    zenith_deg: float, energy: float, kappa: float
) -> None:
    lobe = HEAD.lobe(coordinates(zenith_deg, energy, kappa))[0]
    sky = EnvironmentMap(radiance=lobe)
    assert sky.integrate().tolist() == pytest.approx([energy] * 3, rel=1e-4)
    if 10 < zenith_deg < 80:  # neither cut by the horizon nor on pixels with a pole
        sun = direction_from_angles(
            torch.tensor(AZIMUTH), torch.tensor(math.radians(zenith_deg))
        ).double()
        assert float(angle_between(sky.mean_direction(), sun).rad2deg()) < 1.5


@pytest.mark.parametrize("zenith_deg", [20.0, 44.3, 70.0, 85.0])
@pytest.mark.parametrize("kappa", [2000.0, 6000.0, 20000.0])
def test_splitting_finds_the_lobe_again(zenith_deg: float, kappa: float) -> None:
    """On a uniform sky of radiance 0.3: energy within 3 %, place within half a row."""
    lobe = HEAD.lobe(coordinates(zenith_deg, 4.0, kappa))
    found, rest = HEAD.split(lobe + 0.3)
    zenith = 90 * float(torch.sigmoid(1.5 * found[0, 0]))
    assert zenith == pytest.approx(zenith_deg, abs=1.4)
    assert torch.exp(2 * found[0, 1:4] - 1).tolist() == pytest.approx([4.0] * 3, rel=0.03)
    again = HEAD.lobe(found) + rest
    weight = GRID.solid_angles.float().reshape(HEIGHT, -1, 1)
    # the centroid of pixel middles is not quite that of a lobe narrower than a pixel
    assert float(((again - lobe - 0.3).abs() * weight).sum() / 3) < 0.3 * 4.0


@pytest.mark.parametrize("zenith_deg", [2.5, 7.0, 15.0, 50.0, 82.0])
def test_split_of_a_clear_sky(zenith_deg: float) -> None:
    """The beam's energy within 5 %, the place within half a pixel's row; no sun is left."""
    day = without_clouds(draw_day(3))
    clear = ClearSky(day.atmosphere)
    zenith = math.radians(zenith_deg)
    sky = simulate_sky(day, clear, day.start, 1.0, zenith, height=HEIGHT).sky
    found, rest = HEAD.split(sky.radiance[None])
    beam = clear.sun_irradiance(torch.tensor([zenith]))[0]
    energy = torch.exp(2 * found[0, 1:4] - 1)
    torch.testing.assert_close(energy, beam, rtol=0.05, atol=0)
    assert 90 * float(torch.sigmoid(1.5 * found[0, 0])) == pytest.approx(zenith_deg, abs=1.4)
    assert float(luminance(rest).max()) < 0.02 * float(luminance(sky.radiance).max())


def test_split_and_lobe_keep_the_energy_near_the_sun() -> None:
    generator = torch.Generator().manual_seed(0)
    skies = torch.rand(6, HEIGHT, 4 * HEIGHT, 3, generator=generator) ** 8
    skies[:, 12, 2 * HEIGHT] = 300.0
    found, rest = HEAD.split(skies)
    weight = GRID.solid_angles.float()
    near = (GRID.directions.float() @ direction(12)).acos() < NEAR_RAD
    before = torch.einsum("n,bnc->bc", weight, skies.flatten(1, 2))
    after = torch.einsum("n,bnc->bc", weight, rest.flatten(1, 2))
    energy = torch.exp(2 * found[:, 1:4] - 1)
    torch.testing.assert_close(after + energy, before, rtol=1e-4, atol=1e-4)
    assert (rest <= skies).all()
    assert torch.equal(rest.flatten(1, 2)[:, ~near], skies.flatten(1, 2)[:, ~near])


def direction(row: int) -> torch.Tensor:
    return GRID.directions.float().reshape(HEIGHT, -1, 3)[row, 2 * HEIGHT]


def test_a_uniform_sky_has_no_sun() -> None:
    sky = torch.full((1, HEIGHT, 4 * HEIGHT, 3), 0.7)
    found, rest = HEAD.split(sky)
    assert found.isfinite().all()
    torch.testing.assert_close(rest, sky)
    assert float(EnvironmentMap(radiance=HEAD.lobe(found)[0]).integrate()[0]) < 2e-3


def test_the_lobes_gradient_moves_the_sun() -> None:
    """A lower sun than the target's is told to rise, a weaker one to brighten."""
    target = HEAD.lobe(coordinates(50.0, 4.0, 500.0))
    for start, index, sign in (((53.0, 4.0, 500.0), 0, 1), ((50.0, 3.0, 500.0), 1, -1)):
        free = coordinates(*start).requires_grad_()
        error = (HEAD.lobe(free) - target).square().sum()
        (gradient,) = torch.autograd.grad(error, free)
        assert gradient.shape == (1, COORDINATES)
        assert sign * float(gradient[0, index]) > 0


def test_a_sky_is_split_the_same_in_any_company() -> None:
    """Flat skies too, whose brightest place is a matter of the last digits."""
    generator = torch.Generator().manual_seed(4)
    skies = 1 + 1e-6 * torch.rand(9, HEIGHT, 4 * HEIGHT, 3, generator=generator)
    skies[6:] = 1.0
    together, _ = HEAD.split(skies)
    alone = torch.cat([HEAD.split(sky)[0] for sky in skies.split(1)])
    torch.testing.assert_close(together, alone, rtol=0, atol=1e-6)
