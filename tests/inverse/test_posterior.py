"""How sure the sun is: laws of densities and regions, and a ball under known lights."""

import math
from dataclasses import replace

import pytest
import torch

from skylight.inverse._posterior import (
    FITTED,
    SunEvidence,
    face_evidence,
    interval,
    region_parts,
    smallest_region,
    split_density,
    sun_density,
    sun_evidence,
    sun_posterior,
)
from skylight.inverse._scan import scan_faces
from skylight.models._prior import GaussianMixture
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix
from skylight.transport._observation import Observation
from tests.sunny_face import direction as towards

CELLS, GRID = DirectionGrid.sky(16), DirectionGrid.sky(32)
MEAN = torch.tensor([-1.0, -1.2, -1.5])
SKIN = GaussianMixture(torch.ones(1), MEAN[None], torch.eye(3)[None] / 0.6)


def evidence_of(*suns, kappa=60.0, gain=0.5):
    """Deviations whose likelihood is a sum of von Mises-Fisher lobes about the suns."""
    lobes = torch.stack([kappa * (CELLS.directions @ sun - 1) for sun in suns])
    deviations = 0.1 - FITTED.temperature * torch.logsumexp(lobes, 0)
    return SunEvidence(deviations=deviations, gain=gain)


def posterior_of(evidence, estimate=None, *, sun_prior=None):
    return sun_posterior(
        evidence,
        estimate,
        exposure=3.0,
        albedo=MEAN.exp(),
        specular_scale=None,
        albedo_prior=SKIN,
        sun_prior=sun_prior,
    )


def watched(observation):
    return sun_evidence(face_evidence([observation], scan_faces([observation])))


def ball(light, noise=0.0):
    """The near half of a diffuse ball of 14 pixels under light on 32 x 64 pixels."""
    line = (torch.arange(14) + 0.5) / 7 - 1
    y, x = torch.meshgrid(-line, line, indexing="ij")
    inside = x**2 + y**2 < 0.95
    x, y = x[inside], y[inside]
    normals = torch.stack([x, y, (1 - x**2 - y**2).sqrt()], 1).double()
    grid = DirectionGrid.latlong(32)
    matrix = (normals @ grid.directions.T).clamp(min=0) * grid.solid_angles / math.pi
    seen = matrix @ light
    rough = torch.randn(len(seen), generator=torch.Generator().manual_seed(1)).double()
    seen = (seen * (1 + noise * rough)).clamp(min=0)
    return Observation(
        pixels=(0.5 * seen)[:, None].expand(-1, 3).float(),
        weights=normals[:, 2].float(),
        places=torch.nonzero(inside),
        transport=TransportMatrix(matrix=matrix.float(), grid=grid),
    )


def light_of(sun, share):
    """Radiance: ``share`` of it from 5 degrees about the sun, the rest from everywhere alike."""
    grid = DirectionGrid.latlong(32)
    lobe = torch.exp(130 * (grid.directions @ sun - 1))
    return share * lobe / (lobe @ grid.solid_angles) + (1 - share) / (4 * math.pi)


FRONT = towards(150.0, 50.0)


@pytest.fixture(scope="module")
def lit_ball():
    return watched(ball(light_of(FRONT, 0.6), noise=0.05))


def holds(posterior, sun):
    return bool(posterior.region[(posterior.grid.directions @ sun).argmax()])


@pytest.mark.parametrize("estimate", [None, towards(-40.0, 70.0)], ids=["scan", "with estimate"])
def test_the_density_integrates_to_one_and_its_region_is_the_smallest(estimate):
    found = posterior_of(evidence_of(towards(30.0, 50.0), kappa=20.0), estimate)
    mass = found.density * GRID.solid_angles
    assert (found.density >= 0).all()
    assert float(mass.sum()) == pytest.approx(1, abs=1e-12)
    inside = float(mass[found.region].sum())
    least = found.density[found.region].argmin()
    assert inside - float(mass[found.region][least]) < 0.9 <= inside
    assert found.density[found.region].min() >= found.density[~found.region].max()
    assert found.region_sr == pytest.approx(2 * math.pi * (1 - math.cos(found.region_radius_rad)))


@pytest.mark.parametrize("kappa", [30.0, 100.0])
def test_a_lobe_keeps_its_width_but_for_the_kernel(kappa):
    # 90 % of a narrow von Mises-Fisher density lie within 1 - cos r = ln 10 / kappa
    found = posterior_of(evidence_of(towards(0.0, 45.0), kappa=kappa))
    width = 1 / kappa + FITTED.kernel_rad**2
    assert 1 - math.cos(found.region_radius_rad) == pytest.approx(math.log(10) * width, rel=0.04)


def test_turning_everything_about_the_vertical_turns_the_density():
    sun, other = towards(10.0, 60.0), towards(100.0, 30.0)
    evidence = evidence_of(sun, other)
    one = sun_density(evidence, sun)
    columns = 5  # of the scan; each is two of the density
    turned = evidence.deviations.reshape(16, 64).roll(columns, 1).flatten()
    further = towards(10.0 + columns * 360 / 64, 60.0)
    two = sun_density(replace(evidence, deviations=turned), further)
    expected = one.reshape(32, 128).roll(2 * columns, 1).flatten()
    torch.testing.assert_close(two, expected, rtol=1e-9, atol=1e-12)


def test_an_estimate_draws_the_density_to_it():
    evidence, estimate = evidence_of(towards(0.0, 45.0), kappa=10.0), towards(20.0, 45.0)
    near = GRID.directions @ estimate > math.cos(math.radians(8))
    alone, both = sun_density(evidence, None), sun_density(evidence, estimate)
    assert float(both[near].mean()) > 1.2 * float(alone[near].mean())


def test_parts_are_found_across_the_seam_and_over_the_zenith():
    grid = GRID
    seam = grid.directions @ towards(180.0, 60.0) > math.cos(math.radians(15))
    top = grid.directions[:, 1] > math.cos(math.radians(10))
    density = torch.where(top, 2.0, 1.0).double()
    region = seam | top
    density = density / (density * grid.solid_angles)[region].sum()
    first, second = region_parts(grid, density, region)
    expected = (density * grid.solid_angles)[seam].sum()
    assert {round(first.share, 9), round(second.share, 9)} == {
        round(float(expected), 9),
        round(1 - float(expected), 9),
    }
    assert first.share > second.share


def test_parts_are_those_of_neighbouring_cells():
    generator = torch.Generator().manual_seed(0)
    density = torch.rand(len(GRID.directions), generator=generator, dtype=torch.float64)
    region = torch.rand(len(density), generator=generator) < 0.2
    shares = [part.share for part in region_parts(GRID, density, region)]
    directions, mass = GRID.directions[region], (density * GRID.solid_angles)[region]
    near = directions @ directions.T > math.cos(1.6 * 2 * math.pi / GRID.layout[1])
    reached = near
    while not torch.equal(further := (reached.double() @ near.double()) > 0, reached):
        reached = further
    expected = sorted({round(float(mass[row].sum()), 12) for row in reached}, reverse=True)
    assert len(expected) > 20
    assert shares == pytest.approx(expected, abs=1e-9)


def test_two_suns_that_explain_a_face_alike_are_several_directions():
    suns = towards(110.0, 50.0), towards(-110.0, 50.0)
    found = posterior_of(evidence_of(*suns, kappa=150.0))
    assert [round(part.share, 2) for part in found.parts] == [0.45, 0.45]
    assert all(max(float(part.peak @ sun) for sun in suns) > 0.998 for part in found.parts)


def test_a_ball_in_the_sun_shows_it_and_the_sun_is_in_the_region(lit_ball):
    found = posterior_of(lit_ball, FRONT)
    assert holds(found, FRONT)
    assert found.is_seen
    assert found.region_radius_rad < math.radians(20)


def test_noise_grows_the_region(lit_ball):
    noisy = watched(ball(light_of(FRONT, 0.6), noise=0.4))
    assert posterior_of(noisy).region_sr > 1.3 * posterior_of(lit_ball).region_sr


def test_a_second_face_in_the_same_light_shrinks_the_region(lit_ball):
    both = SunEvidence(deviations=2 * lit_ball.deviations, gain=lit_ball.gain)
    assert posterior_of(both).region_sr < 0.9 * posterior_of(lit_ball).region_sr


def test_a_sun_behind_the_ball_may_be_anywhere_there():
    behind = towards(3.0, 80.0)
    found = posterior_of(watched(ball(light_of(behind, 0.8), noise=0.05)))
    assert holds(found, behind)
    assert found.region_sr > math.pi


def test_light_from_everywhere_is_overcast():
    found = posterior_of(watched(ball(light_of(FRONT, 0.0), noise=0.03)))
    assert found.sun_gain < 0.5 * FITTED.sun_gain
    assert not found.is_seen


def test_the_unit_of_radiance_does_not_matter(lit_ball):
    again = watched(ball(light_of(FRONT, 0.6), noise=0.05).scaled(1000.0))
    torch.testing.assert_close(again.deviations, lit_ball.deviations, rtol=1e-3, atol=1e-5)
    assert again.gain == pytest.approx(lit_ball.gain, rel=1e-3)


def test_albedo_under_a_normal_prior_has_a_normal_interval():
    # three channels of spread 0.6 each, moved together: 0.6 / sqrt 3, about 0.2 below the prior
    low, high = interval(*split_density((MEAN - 0.2).exp(), None, SKIN), 0.3)
    half = 1.6449 * math.hypot(0.6 / math.sqrt(3), 0.3)
    assert math.log(low) == pytest.approx(0.2 - half, abs=0.02)
    assert math.log(high) == pytest.approx(0.2 + half, abs=0.02)


def test_exposure_is_less_sure_where_the_sun_is():
    narrow = posterior_of(evidence_of(FRONT, kappa=200.0))
    wide = posterior_of(evidence_of(FRONT, kappa=2.0))
    for found in (narrow, wide):
        low, high = found.exposure_interval
        assert low < 3.0 < high
        assert math.log(high / 3.0) == pytest.approx(math.log(3.0 / low), abs=0.03)
    assert wide.exposure_interval[1] > 1.3 * narrow.exposure_interval[1]
    assert wide.albedo_scale_interval == narrow.albedo_scale_interval


def test_specular_scale_that_would_be_odd_narrows_the_interval():
    vague = GaussianMixture(torch.ones(1), MEAN[None], torch.eye(3)[None] / 2.0)
    _, free = split_density(MEAN.exp(), None, vague)
    shift, held = split_density(MEAN.exp(), 1.0, vague)
    # precisions add: 3 / 2^2 and 1 / 0.7^2
    assert float(held @ shift**2) == pytest.approx(1 / (3 / 4 + 1 / 0.7**2), rel=1e-3)
    assert float(held @ shift**2) < float(free @ shift**2)


def test_the_smallest_region_of_equal_densities_is_as_large_as_its_share():
    density = torch.full((len(GRID),), 1 / (2 * math.pi), dtype=torch.float64)
    region = smallest_region(density, GRID.solid_angles, 0.5)
    assert float(GRID.solid_angles[region].sum()) == pytest.approx(math.pi, abs=2e-3)


def test_faces_add_their_deviations_and_share_the_gain(lit_ball):
    one, other = ball(light_of(FRONT, 0.6), noise=0.05), ball(light_of(towards(-120.0, 40.0), 0.3))
    both = sun_evidence(face_evidence([one, other], scan_faces([one, other])))
    alone = lit_ball, watched(other)
    torch.testing.assert_close(both.deviations, sum(face.deviations for face in alone))
    without_sun = sum(face.gain + float(face.deviations.min()) for face in alone)
    assert both.gain == pytest.approx((without_sun - float(both.deviations.min())) / 2)
    twice = sun_evidence(face_evidence([one, one], scan_faces([one, one])))
    assert twice.gain == pytest.approx(lit_ball.gain)
