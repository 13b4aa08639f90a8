"""Cloud layers, the light in a slab of cloud, and the noise that clouds are cut from."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st

from skylight.skies._clouds import (
    CELLS,
    CLOUD_G,
    FORWARD,
    SCALED_G,
    CloudLayer,
    LayerLight,
    Wind,
    fractal_noise,
    march,
    shadow,
    slab_light,
    two_lobes,
)
from skylight.sphere._frame import DirectionGrid, direction_from_angles
from tests.oracles.slab import photons_below

GRID = DirectionGrid.sky(32)
DIRECTIONS, SOLID = GRID.directions.float(), GRID.solid_angles.float()
CALM = Wind(east_km=0.0, south_km=0.0, change=0.0)
FOOTPRINT = math.pi / 2 / 32


def sun_at(zenith_deg: float) -> torch.Tensor:
    return direction_from_angles(torch.tensor(0.4), torch.tensor(math.radians(zenith_deg)))


def deck(depth: float) -> CloudLayer:
    """The same density everywhere between floor and ceiling."""
    return CloudLayer(
        coverage=9.0, depth=depth, base_km=1.0, thickness_km=0.5, softness=1e-3, erosion=0.0
    )


def broken(**changes: float) -> CloudLayer:
    layer = CloudLayer(coverage=0.5, depth=10.0, thickness_km=0.5, towering=0.0, seed=4)
    return replace(layer, **changes)


def through(
    layer: CloudLayer,
    sun: torch.Tensor,
    directions: torch.Tensor = DIRECTIONS,
    *,
    wind: Wind = CALM,
    albedo: float = 0.0,
    footprint: float = FOOTPRINT,
) -> LayerLight:
    return march(layer, directions, sun, wind, footprint_rad=footprint, ground_albedo=albedo)


def rows(values: torch.Tensor) -> torch.Tensor:
    return values.reshape(32, 128).mean(1)


@pytest.mark.parametrize("depth", [0.3, 3.0, 10.0, 40.0])
@pytest.mark.parametrize("mu0", [0.25, 0.9])
def test_a_uniform_deck_sends_down_what_photons_do(depth: float, mu0: float) -> None:
    """Irradiance below it, disc included, as a share of what falls on it."""
    light = through(deck(depth), sun_at(math.degrees(math.acos(mu0))))
    sent = float((SOLID * DIRECTIONS[:, 1]) @ light.beam) / mu0 + math.exp(-depth / mu0)
    truth, _ = photons_below(depth, mu0, g=CLOUD_G, count=20_000)
    assert sent == pytest.approx(truth, abs=0.05)


def test_radiance_below_a_thick_deck_is_that_of_photons() -> None:
    """By bands of height, within 15 % of Monte Carlo (20,000 photons came through)."""
    mu0, count = 0.6, 120_000
    light = through(deck(25.0), sun_at(math.degrees(math.acos(mu0))))
    _, cosines = photons_below(25.0, mu0, g=CLOUD_G, count=count)
    edges = [0.15, 0.4, 0.6, 0.8, 1.0]
    arrived, _ = np.histogram(cosines, edges)
    for low, high, photons in zip(edges, edges[1:], arrived, strict=False):
        band = (DIRECTIONS[:, 1] > low) & (DIRECTIONS[:, 1] <= high)
        radiance = float((light.beam * SOLID)[band].sum() / SOLID[band].sum())
        truth = photons / count * mu0 / (math.pi * (high**2 - low**2))
        assert radiance == pytest.approx(truth, rel=0.15)


def test_overcast_brightens_upwards_like_the_cie_sky() -> None:
    """L = L_z (1 + 2 sin h) / 3 (CIE standard overcast sky), within 12 % above 10 degrees."""
    light = through(deck(60.0), sun_at(50.0))
    height = DIRECTIONS[:, 1].reshape(32, 128)[:, 0]
    found, expected = rows(light.beam), (1 + 2 * height) / 3
    above = height > math.sin(math.radians(10))
    relative = found / found[0] / (expected / expected[0])
    assert float((relative[above] - 1).abs().max()) < 0.12


def test_without_a_sun_the_deck_hides_the_sky_and_keeps_its_light() -> None:
    """Under a uniform sky of radiance 1 over black ground: what passes and what is scattered."""
    up = SOLID * DIRECTIONS[:, 1]
    received = []
    for depth in (0.0, 1.0, 5.0, 30.0):
        light = through(deck(depth), sun_at(40.0))
        received.append(float(up @ (light.passed + math.pi * light.sky)) / math.pi)
    assert received[0] == pytest.approx(1, abs=1e-3)
    assert all(a > b for a, b in pairwise(received))
    # diffuse light on a thick conservative slab: 1 / (1 + 3/4 (1 - g) tau) to leading order
    assert received[-1] == pytest.approx(1 / (1 + 0.75 * (1 - CLOUD_G) * 30), rel=0.05)


@pytest.mark.parametrize("zenith_deg", [20.0, 60.0])
def test_the_shadow_of_a_deck_is_its_slant_transmittance(zenith_deg: float) -> None:
    sun = sun_at(zenith_deg)
    passed = shadow(deck(3.0), CALM, DIRECTIONS, 0.5, sun)  # depth to a tenth, by four steps
    expected = math.exp(-(1 - FORWARD) * 3.0 / float(sun[1]))
    assert passed.log().mean().item() == pytest.approx(math.log(expected), rel=0.1)


def test_shadows_are_the_clouds_seen_against_the_sun() -> None:
    """A place is in the shadow if a ray from it to the sun meets cloud; here from the ground up."""
    sun = sun_at(35.0)
    overhead = torch.tensor([[0.0, 1.0, 0.0]])
    for seed in range(12):
        layer = broken(depth=60.0, erosion=0.0, seed=seed)
        seen = float(through(layer, sun, sun[None], footprint=0.0).passed)
        assert float(shadow(layer, CALM, overhead, 0.0, sun)) == pytest.approx(seen, abs=0.15)


def test_shadows_fall_where_rays_meet_a_height() -> None:
    """On a place 1 km up, at the end of an oblique ray: that of a layer drifted the other way."""
    sun, layer = sun_at(35.0), broken(depth=60.0, erosion=0.0)
    overhead, height = torch.tensor([[0.0, 1.0, 0.0]]), 1.0
    found = []
    for azimuth in torch.linspace(0, 6, 25):
        ray = direction_from_angles(azimuth, torch.tensor(math.radians(50.0)))
        east, _, south = (height / ray[1] * ray).tolist()  # flat to 1e-4 of so short a ray
        there = shadow(layer, CALM, ray[None], height, sun)
        moved = Wind(east_km=-east, south_km=-south, change=0.0)
        assert float(there) == pytest.approx(
            float(shadow(layer, moved, overhead, height, sun)), abs=0.02
        )
        found.append(float(there))
    assert min(found) < 0.2
    assert max(found) > 0.8


def test_white_ground_under_a_deck_brightens_it() -> None:
    dark, snow = (through(deck(20.0), sun_at(30.0), albedo=a).beam.mean() for a in (0.0, 0.8))
    assert float(snow) > 1.5 * float(dark)


def test_the_beam_fades_and_does_not_switch() -> None:
    """Across a cloud's edge the disc's transmittance takes all values in between."""
    azimuth = torch.linspace(-math.pi, math.pi, 4001)
    ring = direction_from_angles(azimuth, torch.full_like(azimuth, 0.6))
    light = through(broken(softness=0.3), sun_at(34.0), ring, footprint=0.0)
    share = torch.exp(-light.depth)
    counts = torch.histc(share, 10, 0, 1)
    assert (counts[1:-1] > 4).all()
    assert float(torch.diff(share).abs().max()) < 0.2


def test_thin_edges_near_the_sun_are_bright() -> None:
    """The silver lining: near the sun thin cloud outshines thick, away from it the reverse."""
    sun = sun_at(40.0)
    around = DIRECTIONS @ sun
    near = (around > math.cos(math.radians(8))) & (around < math.cos(math.radians(3)))
    away = around < math.cos(math.radians(60))
    thin, thick = (through(deck(d), sun).beam for d in (0.8, 20.0))
    assert float(thin[near].mean()) > 5 * float(thick[near].mean())
    assert float(thin[away].mean()) < float(thick[away].mean())


@pytest.mark.parametrize("coverage", [0.2, 0.5, 0.8])
def test_coverage_is_the_share_of_the_floor(coverage: float) -> None:
    """Over layers of a thickness that the noise hardly notices, in the upper part of the sky."""
    high = DIRECTIONS[DIRECTIONS[:, 1] > 0.5][::3]
    covered = []
    for seed in range(20):
        layer = broken(coverage=coverage, thickness_km=0.02, cell_km=1.0, erosion=0.0)
        light = through(replace(layer, seed=seed), sun_at(30.0), high)
        covered.append((light.depth > 0).float().mean())
    assert float(torch.stack(covered).mean()) == pytest.approx(coverage, abs=0.06)


def test_depth_is_the_columns_optical_depth() -> None:
    up = torch.tensor([[0.0, 1.0, 0.0]])
    light = through(deck(7.0), sun_at(30.0), up)
    assert float(light.depth) == pytest.approx(7.0, rel=0.03)
    slanted = direction_from_angles(torch.tensor([0.0]), torch.tensor([math.radians(60.0)]))
    assert float(through(deck(7.0), sun_at(30.0), slanted).depth) == pytest.approx(14, rel=0.03)


def test_drift_moves_the_clouds_overhead() -> None:
    """Wind of x km east shows at the zenith what stood x km to the west."""
    base = 1.0
    west = torch.tensor([[-0.5, base, 0.0]])
    up = torch.tensor([[0.0, base, 0.0]])
    layer = broken(base_km=base, thickness_km=0.01, erosion=0.0, softness=0.6, cell_km=1.0)
    sun, moved = sun_at(30.0), Wind(east_km=0.5, south_km=0.0, change=0.0)
    there = through(layer, sun, west / west.norm()).depth * float(west[0, 1] / west.norm())
    here = through(layer, sun, up, wind=moved).depth
    torch.testing.assert_close(here, there, rtol=0.02, atol=0.02)
    later = through(layer, sun, up, wind=Wind(east_km=0.5, south_km=0.0, change=3.0)).depth
    assert abs(float(later - here)) > 0.1


@pytest.mark.slow
def test_drift_is_smooth_over_many_cells() -> None:
    """The finer octaves, whose periods are not the tile's, do not jump where the tile repeats."""
    layer = broken(base_km=1.0, cell_km=1.0, erosion=0.5, softness=0.6)
    east = torch.arange(0, 40, 0.02).tolist()
    up = torch.tensor([[0.0, 1.0, 0.0]])
    depth = torch.cat(
        [
            through(
                layer,
                sun_at(30.0),
                up,
                wind=Wind(east_km=e, south_km=0.0, change=0.0),
                footprint=0.0,
            ).depth
            for e in east
        ]
    )
    steps = depth.diff().abs()
    assert float(steps.max()) < 12 * float(steps[steps > 0].median()) + 0.5
    assert float(depth.max() - depth.min()) > 3


def test_detail_too_fine_to_see_fades_out() -> None:
    layer = broken(erosion=0.8, cell_km=1.0, thickness_km=0.02, softness=1.0)
    variations = [
        float(
            through(layer, sun_at(30.0), footprint=f).depth.reshape(32, 128)[8].diff().abs().mean()
        )
        for f in (0.0, 0.05, 0.5)
    ]
    assert variations[0] > 1.05 * variations[1]
    assert variations[1] > 1.05 * variations[2]


@settings(deadline=None, max_examples=12)
@given(
    coverage=st.floats(0.02, 1.3),
    depth=st.floats(0.05, 150),
    softness=st.floats(0.05, 1.3),
    towering=st.floats(0, 0.6),
    base_km=st.floats(0.5, 10),
    thickness_km=st.floats(0.05, 3),
    stretch=st.floats(1, 4),
    sun_zenith_deg=st.floats(0, 89),
)
def test_light_of_any_layer_is_finite_and_bounded(
    coverage: float,
    depth: float,
    softness: float,
    towering: float,
    base_km: float,
    thickness_km: float,
    stretch: float,
    sun_zenith_deg: float,
) -> None:
    layer = CloudLayer(
        coverage=coverage,
        depth=depth,
        softness=softness,
        towering=towering,
        base_km=base_km,
        thickness_km=thickness_km,
        stretch=stretch,
        seed=7,
    )
    light = through(layer, sun_at(sun_zenith_deg), albedo=0.2)
    assert (light.depth >= 0).all()
    assert ((light.passed >= 0) & (light.passed <= 1)).all()
    assert (torch.exp(-light.depth) <= light.passed + 1e-6).all()
    for part in (light.beam, light.sky):
        assert part.isfinite().all()
        assert (part >= 0).all()
        assert (part[light.depth == 0] == 0).all()


@settings(deadline=None, max_examples=12)
@given(
    coverage=st.floats(0.05, 1.3),
    depth=st.floats(0.1, 100),
    towering=st.floats(0, 0.5),
    thickness_km=st.floats(0.1, 2.5),
    sun_zenith_deg=st.floats(0, 70),
)
def test_no_layer_sends_down_more_than_comes_in(
    coverage: float, depth: float, towering: float, thickness_km: float, sun_zenith_deg: float
) -> None:
    """Over black ground, of a uniform sky and of the sun, what is scattered and what passes."""
    layer = CloudLayer(
        coverage=coverage, depth=depth, towering=towering, thickness_km=thickness_km, seed=3
    )
    sun = sun_at(sun_zenith_deg)
    light, up = through(layer, sun), SOLID * DIRECTIONS[:, 1]
    assert float(up @ (math.pi * light.sky + light.passed)) / math.pi <= 1.02
    # of the beam, what is scattered alone: what passes depends on the gap that the sun stands in
    assert float(up @ light.beam) / float(sun[1]) <= 1.02


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


def places(count: int) -> torch.Tensor:
    return 50 * torch.rand(count, 3, generator=torch.Generator().manual_seed(0))


def test_values_are_uniform() -> None:
    value = fractal_noise(places(100_000))
    assert float(value.min()) >= 0
    assert float(value.max()) <= 1
    for q in (0.02, 0.1, 0.25, 0.5, 0.75, 0.9, 0.98):
        assert float((value < q).float().mean()) == pytest.approx(q, abs=0.03)


def test_the_tile_repeats_without_a_seam() -> None:
    p = places(2_000)
    torch.testing.assert_close(fractal_noise(p + CELLS), fractal_noise(p), rtol=0, atol=2e-3)
    step = 1e-3
    across = torch.tensor([[0.0, 3.3, 7.7]]).expand(3, 3).clone()
    for axis in range(3):
        across[axis, axis] = CELLS - step / 2
    jump = fractal_noise(across + step * torch.eye(3)) - fractal_noise(across)
    assert float(jump.abs().max()) < 0.02


def test_it_is_smooth_and_random() -> None:
    p = places(5_000)
    assert float((fractal_noise(p + 0.01) - fractal_noise(p)).abs().max()) < 0.12
    # a few cells apart values know nothing of each other
    far = torch.corrcoef(
        torch.stack([fractal_noise(p), fractal_noise(p + torch.tensor([5.5, 0.0, 3.1]))])
    )[0, 1]
    assert abs(float(far)) < 0.1
    near = torch.corrcoef(torch.stack([fractal_noise(p), fractal_noise(p + 0.1)]))[0, 1]
    assert float(near) > 1 - 10 * 0.1**2 * math.pi
