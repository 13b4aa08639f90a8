import math
from itertools import pairwise

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from skylight.skies.clouds import (
    CloudLayer,
    _fractal_noise,
    cloud_light,
    optical_depth,
    unscattered,
)
from skylight.sphere.frame import direction_from_angles
from skylight.sphere.grid import DirectionGrid

GRID = DirectionGrid.sky(32)
DIRECTIONS, SOLID = GRID.directions.float(), GRID.solid_angles.float()
FOOTPRINT = math.pi / 2 / 32
BEAM, NIGHT = torch.ones(3), torch.zeros(3)


def sun_at(zenith_deg: float) -> torch.Tensor:
    return direction_from_angles(torch.tensor(0.0), torch.tensor(math.radians(zenith_deg)))


def deck(tau: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Optical depth and incidence of a flat uniform layer."""
    return torch.full((len(GRID),), tau), DIRECTIONS[:, 1]


def scattered(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    x, z = 400 * torch.rand(2, count, generator=generator)
    return x, z


@pytest.mark.parametrize("seed", [0, (1 << 30) - 1])
def test_noise_is_close_to_standard_normal(seed: int) -> None:
    x, z = scattered(30_000)
    noise = _fractal_noise(x, z, 0.4, torch.zeros_like(x), seed)
    assert float(noise.mean()) == pytest.approx(0, abs=0.06)
    assert float(noise.std()) == pytest.approx(1, abs=0.12)
    for quantile, above in ((-1.2816, 0.9), (-0.6745, 0.75), (0.6745, 0.25), (1.2816, 0.1)):
        assert float((noise > quantile).float().mean()) == pytest.approx(above, abs=0.05)


def test_noise_is_continuous_and_follows_its_seed() -> None:
    x, z = scattered(2_000)
    zero = torch.zeros_like(x)
    noise = _fractal_noise(x, z, 0.4, zero, 5)
    assert torch.equal(noise, _fractal_noise(x, z, 0.4, zero, 5))
    nearby = _fractal_noise(x + 1e-3, z, 0.401, zero, 5)
    assert float((nearby - noise).abs().max()) < 0.15
    other = _fractal_noise(x, z, 0.4, zero, 6)
    assert abs(float(torch.corrcoef(torch.stack([noise, other]))[0, 1])) < 0.15


def test_octaves_too_fine_to_see_fade_out() -> None:
    x, z = scattered(5_000)
    spread = [
        float(_fractal_noise(x, z, 0.0, torch.full_like(x, footprint), 1).std())
        for footprint in (0.0, 0.1, 0.3, 1.0)
    ]
    assert spread == sorted(spread, reverse=True)
    assert spread[-1] == 0


@pytest.mark.parametrize("coverage", [0.1, 0.5, 0.9999])
def test_coverage_is_the_covered_fraction(coverage: float) -> None:
    """Over many layers, in the well-resolved upper part of the sky."""
    high = DIRECTIONS[DIRECTIONS[:, 1] > 0.5][::3]
    covered = []
    for seed in range(20):
        layer = CloudLayer(coverage=coverage, depth=10.0, cell_km=1.0, seed=seed)
        tau, _ = optical_depth(layer, high, (100.0 * seed, 0.0), 0.0, 0.0)
        covered.append((tau > 0).float().mean())
    assert float(torch.stack(covered).mean()) == pytest.approx(coverage, abs=0.07)


@settings(deadline=None, max_examples=15)
@given(
    coverage=st.floats(0.01, 0.9999),
    depth=st.floats(0.05, 100),
    softness=st.floats(0.05, 2),
    height_km=st.floats(0.5, 10),
    sun_zenith_deg=st.floats(0, 89),
)
def test_light_of_a_layer_is_finite_and_bounded(
    coverage: float, depth: float, softness: float, height_km: float, sun_zenith_deg: float
) -> None:
    layer = CloudLayer(
        coverage=coverage, depth=depth, softness=softness, height_km=height_km, seed=7
    )
    tau, incidence = optical_depth(layer, DIRECTIONS, (3.0, -2.0), 0.5, FOOTPRINT)
    assert (tau >= 0).all()
    # single precision knows a distance to half a metre: 0.1 % of a low layer's height
    assert ((incidence > 0) & (incidence <= 1 + 2e-3)).all()
    sun = sun_at(sun_zenith_deg)
    through, glow = cloud_light(tau, tau, incidence, DIRECTIONS, sun, BEAM, 0.1 * BEAM)
    for part in (through, unscattered(tau, incidence)):
        assert ((part >= 0) & (part <= 1)).all()
    assert (unscattered(tau, incidence) <= through + 1e-6).all()
    assert glow.isfinite().all()
    assert (glow >= 0).all()
    assert (glow[tau == 0] == 0).all()


@pytest.mark.parametrize("sun_zenith_deg", [0.0, 30.0, 60.0, 80.0])
def test_a_uniform_deck_makes_no_energy(sun_zenith_deg: float) -> None:
    """What passes falls with the depth and stays below what came from above."""
    sun = sun_at(sun_zenith_deg)
    beam_down = float(sun[1])
    received = []
    for depth in (0.0, 0.1, 0.5, 2.0, 8.0, 30.0, 100.0):
        tau, incidence = deck(depth)
        through, glow = cloud_light(tau, tau, incidence, DIRECTIONS, sun, BEAM, NIGHT)
        sky = (DIRECTIONS[:, 1] * SOLID) @ glow[:, 0]
        # the disc itself and the glow of the forward peak round it
        at_sun, _ = cloud_light(tau[:1], tau[:1], sun[1:2], sun[None], sun, BEAM, NIGHT)
        received.append((float(sky) + float(at_sun) * beam_down) / beam_down)
        assert float(through.max()) <= 1
    assert received[0] == pytest.approx(1, abs=1e-6)
    assert all(a > b * 0.99 for a, b in pairwise(received))
    # two-stream (conservative layer, g = 0.85) at the thick end
    assert received[-1] == pytest.approx(1 / (1 + 0.75 * 0.15 * 100), rel=0.05)


def test_overcast_zenith_is_three_times_the_horizon() -> None:
    """CIE standard overcast sky: L = L_z (1 + 2 sin h) / 3."""
    tau, incidence = deck(80.0)
    _, glow = cloud_light(tau, tau, incidence, DIRECTIONS, sun_at(50), BEAM, NIGHT)
    rows = glow[:, 0].reshape(32, 128).mean(1)
    expected = (1 + 2 * DIRECTIONS[:, 1].reshape(32, 128)[:, 0]) / 3
    torch.testing.assert_close(rows / rows[0], expected / expected[0], rtol=0.02, atol=0)


def test_one_more_cloud_in_front_of_the_same_light_only_takes() -> None:
    """Thin cloud before a uniform sky: between all of the light and the two-stream share."""
    sky = BEAM * math.pi  # the irradiance of uniform radiance 1
    tau, incidence = deck(5.0)
    through, glow = cloud_light(tau, tau, incidence, DIRECTIONS, sun_at(40), NIGHT, sky)
    total = (DIRECTIONS[:, 1] * SOLID) @ (through[:, None] + glow)
    assert 0.5 < float(total[0]) / math.pi < 1


def test_layer_meets_the_view_ray_on_its_sphere() -> None:
    layer = CloudLayer(coverage=0.5, depth=1.0, height_km=4.0)
    up = torch.tensor([[0.0, 1.0, 0.0]])
    level = torch.tensor([[1.0, 1e-3, 0.0]])
    _, incidence = optical_depth(layer, torch.cat([up, level]), (0.0, 0.0), 0.0, FOOTPRINT)
    # a level ray meets a shell of height h at cos = sqrt(1 - (R / (R + h))^2)
    expected = math.sqrt(1 - (6360 / 6364) ** 2)
    assert incidence.tolist() == pytest.approx([1.0, expected], rel=1e-3)
