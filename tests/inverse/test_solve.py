"""The solvers on pictures of a ball by oracles: its light, albedo and specular scale come back."""

import copy
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.faces._skin import MELANIN_COLOUR, SkinPrior
from skylight.inverse._descent import Stage
from skylight.inverse._estimate import estimate_light
from skylight.inverse._faces import Level, ObjectiveWeights
from skylight.inverse._harmonic import HarmonicProblem
from skylight.inverse._problem import solve
from skylight.inverse._result import residual
from skylight.inverse._scale import bayes_scale, scale_nll, tone_prior
from skylight.inverse._sky import SkyProblem, SolverOptions
from skylight.models._bundle import load_bundle
from skylight.models._ground import KnownGround, LambertianGround
from skylight.models._harmonic import HarmonicLight
from skylight.models.sunsky import SunSky
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix
from skylight.transport._observation import Observation
from skylight.transport._reflection import specular_transport
from skylight.transport._render import Specular
from tests.oracles import harmonics
from tests.oracles.outdoors import Outdoors

SKIN = SkinPrior.load()
# a copy: the prior is loaded once a process, and .float() changes a module in place
SUNSKY_PRIOR = load_bundle().sunsky_prior
ALBEDO_PRIOR = copy.deepcopy(SKIN.log_albedo).float()
MODES = SKIN.means.float()
# (azimuth, zenith angle) in degrees; the camera looks along azimuth 0
SUNS = [(140.0, 40.0), (-110.0, 60.0), (170.0, 20.0)]


EXPOSURE = 2.5
ALBEDO = MODES[0].double().numpy()


@cache
def ball_normals(side=16):
    """(pixels, normals) of the near half of a ball seen from afar along -Z, float64."""
    line = (np.arange(side) + 0.5) / side * 2 - 1
    y, x = np.meshgrid(-line, line, indexing="ij")
    inside = x**2 + y**2 < 0.95
    x, y = x[inside], y[inside]
    return np.argwhere(inside), np.stack([x, y, np.sqrt(1 - x**2 - y**2)], 1)


def observed(pixels, rows=64):
    """The ball's pixels (m,3) with the diffuse and the specular transport that the solvers need."""
    places, normals = (torch.from_numpy(part) for part in ball_normals())
    grid = DirectionGrid.latlong(rows)
    cosine = (normals @ grid.directions.T).clamp(min=0)
    transport = TransportMatrix(matrix=(cosine * grid.solid_angles / math.pi).float(), grid=grid)
    views = torch.tensor([0.0, 0.0, 1.0]).expand(len(normals), 3)
    return Observation(
        pixels=torch.from_numpy(pixels).float(),
        weights=torch.ones(len(pixels)),
        places=places,
        transport=transport,
        specular=specular_transport(transport, normals.float(), views, Specular()),
    )


@cache
def watched(azimuth, zenith):
    """(observation of a skin-like ball out of doors, what it was lit by)."""
    azimuth, zenith = math.radians(azimuth), math.radians(zenith)
    sine = math.sin(zenith)
    sun = [sine * math.sin(azimuth), math.cos(zenith), -sine * math.cos(azimuth)]
    world = Outdoors(
        sun,
        sky=[0.45, 0.55, 0.8],
        sun_irradiance=[5.5, 5.0, 4.2],
        ground=[0.15, 0.13, 0.11],
        rows=32,
    )
    _, normals = ball_normals()
    diffuse = ALBEDO / math.pi * world.irradiance(normals)
    pixels = EXPOSURE * (diffuse + world.specular(normals, np.array([0.0, 0.0, 1.0])))
    return observed(pixels), world


def irradiance(environment, normals):
    """Of unoccluded planes in a map, by the sum over its pixels."""
    grid = DirectionGrid.latlong(environment.layout[0])
    cosine = (torch.from_numpy(normals) @ grid.directions.T).clamp(min=0)
    return ((cosine * grid.solid_angles) @ environment.flat.double()).numpy()


def stages(*iterations):
    """So many iterations on each level, the coarsest first; for laws of any effort."""
    return tuple(
        Stage(level=Level(3 - k), starts=2 if k == 0 else 1, iterations=count)
        for k, count in enumerate(iterations)
    )


FEW = (*stages(4, 3), Stage(level=Level(1), starts=1, iterations=2, steps="broyden"))


def solved(observation, prior=None, progress=None, **options):
    problem = SkyProblem(
        SunSky(), prior or SUNSKY_PRIOR, ALBEDO_PRIOR, MODES, SolverOptions(**options)
    )
    problem.add(observation)
    return solve([problem], progress)[0]


@cache
def found_under(sun):
    """(observation, what it was lit by, estimate), made once for all tests that look at it."""
    observation, world = watched(*sun)
    return observation, world, solved(observation)


@pytest.fixture(scope="module")
def first():
    observation, _, found = found_under(SUNS[0])
    return observation, found


@pytest.fixture(scope="module")
def quick():
    """(observation, an estimate of few iterations)"""
    observation, _ = watched(*SUNS[0])
    return observation, solved(observation, stages=FEW)


@pytest.mark.parametrize("sun", [*SUNS[:2], pytest.param(SUNS[2], marks=pytest.mark.slow)])
def test_sun_albedo_specular_scale_and_light_come_back(sun):
    _, world, found = found_under(sun)
    assert math.degrees(math.acos(float(found.sun_direction.double().numpy() @ world.sun))) < 1.5
    assert found.faces[0].specular_scale == pytest.approx(1, abs=0.15)
    # a picture shows albedo times light: the tone alone is left to the prior
    ratio = found.albedo.double().numpy() / ALBEDO
    assert ratio == pytest.approx(ratio.mean(), rel=0.05)
    assert 1 / 1.3 < ratio.mean() < 1.3
    # towards the camera, level and towards the sun
    normals = np.stack([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], world.sun])
    truth = EXPOSURE * world.irradiance(normals)
    relit = irradiance(found.environment, normals)
    np.testing.assert_allclose(ratio * relit, truth, rtol=0.13)
    np.testing.assert_allclose(relit, truth, rtol=0.3)
    assert found.faces[0].residual < 0.04  # below the noise that the objective expects
    assert found.advice == ()


def test_a_known_ground_holds(first):
    """Snow that is sure, and wrong, against a ball that shows what is below it."""
    observation, usual = first
    snow = KnownGround(albedo=(0.8, 0.8, 0.8), spread=0.01)
    found = solved(observation, ground=snow, stages=FEW)
    np.testing.assert_allclose(found.ground_albedo, 0.8, rtol=0.1)
    assert usual.ground_albedo.max() < 0.5


def darker_below(azimuth, zenith):
    """A ball out of doors whose lower half has more melanin: 15 % less green."""
    seen, world = watched(azimuth, zenith)
    _, normals = ball_normals()
    below = 0.5 - 0.5 * np.tanh(normals[:, 1] / 0.3)
    kept = np.exp(math.log(0.85) * below[:, None] * MELANIN_COLOUR)
    less = (1 - kept) * ALBEDO / math.pi * world.irradiance(normals)
    # fields that bend, as those of faces; the planted one is none of them
    x, y = normals[:, 0], normals[:, 1]
    modes = np.stack([y, x, y**2 - y**4, x * y, x**2, y**3], 1)
    modes = torch.from_numpy(modes - modes.mean(0)).float()
    darker = seen.pixels - EXPOSURE * torch.from_numpy(less).float()
    return replace(seen, pixels=darker, modes=modes), world


@pytest.mark.slow
@pytest.mark.parametrize("sun", [(-110.0, 60.0), (170.0, 60.0), (150.0, 70.0)])
def test_a_darker_lower_half_is_no_higher_sun(sun):
    """Of even skin it is shading; minimised to the end, since neither path there is short."""
    seen, world = darker_below(*sun)
    errors = []
    for spread in (0.0, 1.0):
        found = solved(
            seen,
            stages=(
                *stages(10, 40),
                Stage(level=Level(1), starts=1, iterations=20, steps="gauss-newton"),
                Stage(level=Level(0), starts=1, iterations=30, steps="gauss-newton"),
            ),
            tolerance=1e-8,
            weights=ObjectiveWeights(pigment_spread=spread),
        )
        height = math.asin(float(found.sun_direction[1])) - math.asin(world.sun[1])
        errors.append(math.degrees(abs(height)))
    assert errors[0] > 0.3
    assert errors[1] < 0.5 * errors[0]


def test_an_estimate_is_in_itself_consistent(first):
    observation, found = first
    assert found.light == "sunsky"
    assert found.environment.layout == (256, 512)
    assert (found.environment.radiance >= 0).all()
    # the picture again from the parameters, on the rows that it was fitted on
    sky = SunSky()(found.params[None])[0] * found.exposure
    flat = LambertianGround().append(sky, found.ground_albedo)
    rendered = found.albedo * (observation.transport.matrix @ flat)
    rendered = rendered + found.faces[0].specular_scale * (observation.specular.matrix @ flat)
    shown = found.faces[0].edit.apply(found.white_balance * rendered)
    torch.testing.assert_close(shown, found.rendered, rtol=1e-4, atol=1e-5)
    sky = SunSky(128)(found.params[None])[0] * found.exposure
    torch.testing.assert_close(sky, found.environment.upper().flat, rtol=1e-4, atol=1e-5)
    assert found.environment.radiance[128:].reshape(-1, 3).std(0).max() < 1e-5  # one ground
    low, high = SunSky().bounds
    assert ((found.params >= low) & (found.params <= high)).all()


def test_the_same_picture_gives_the_same_light(quick):
    observation, found = quick
    again = solved(observation, stages=FEW)
    assert torch.equal(again.params, found.params)
    assert torch.equal(again.environment.radiance, found.environment.radiance)
    assert (again.terms, again.stats, again.status) == (found.terms, found.stats, found.status)


def test_a_brighter_exposure_changes_only_the_exposure(quick):
    observation, found = quick
    brighter = solved(observation.scaled(4.0), stages=FEW)  # a power of two: the same roundings
    torch.testing.assert_close(brighter.params, found.params)
    assert brighter.exposure == pytest.approx(4 * found.exposure)
    torch.testing.assert_close(brighter.environment.radiance, 4 * found.environment.radiance)


def test_the_status_tells_how_it_ended(quick):
    observation, _ = quick
    patient = solved(observation, stages=stages(5, 200), tolerance=1e-3)
    assert patient.status == "converged"
    shares = []
    hurried = solved(observation, progress=shares.append, stages=stages(2, 1), tolerance=0.0)
    assert hurried.status == "iteration limit"
    assert shares == [0.5, 1.0]

    class Flaw:
        """A prior that is not a number once, on the first step after the start."""

        calls = 0

        def log_prob(self, x):
            self.calls += 1
            value = SUNSKY_PRIOR.log_prob(x)
            return value * torch.nan if self.calls == 2 else value

        def sample(self, count, generator):
            return SUNSKY_PRIOR.sample(count, generator)

    # without tolerance it cannot converge, so the flaw is what the status has to tell
    flawed = solved(observation, Flaw(), stages=stages(3, 1), tolerance=0.0)
    assert flawed.status == "recovered from a non-finite step"
    assert flawed.stats["nonfinite"] > 0
    assert flawed.environment.radiance.isfinite().all()
    assert math.isfinite(sum(flawed.terms.values()))


def test_pictures_that_no_light_explains_come_with_advice(quick):
    observation, _ = quick
    checks = 0.2 + 1.6 * (observation.places.sum(1) % 2).float()
    spoilt = Observation(
        pixels=observation.pixels * checks[:, None],
        weights=observation.weights,
        places=observation.places,
        transport=observation.transport,
    )
    fine = Stage(level=Level(0), starts=1, iterations=3)
    (advice,) = solved(spoilt, stages=(fine,)).advice
    assert "unreliable" in advice


def harmonic_light(degree):
    """Coefficients of a light without degree 3, of which a diffuse ball shows nothing."""
    coefficients = 0.15 * np.random.default_rng(degree).standard_normal(((degree + 1) ** 2, 3))
    coefficients[0] = 4.0
    coefficients[9:16] = 0.0
    return coefficients


def harmonic_ball(degree):
    """(light model, a diffuse ball in a light of that model)."""
    _, normals = ball_normals()
    light = torch.from_numpy(harmonic_light(degree))
    shading = harmonics.irradiance(light, torch.from_numpy(normals)).numpy() / math.pi
    diffuse = replace(observed(MODES[1].double().numpy() * shading, rows=32), specular=None)
    return HarmonicLight(degree, height=32), diffuse


@pytest.mark.parametrize("light", ["sh9", "sunsky", "autoencoder"])
def test_nothing_observed_is_refused(light):
    with pytest.raises(InputError, match="no observation"):
        estimate_light([], light)


def solve_harmonic(observation, model):
    problem = HarmonicProblem(model, ALBEDO_PRIOR, MODES)
    problem.add(observation)
    return solve([problem])[0]


@pytest.mark.parametrize("degree", [2, 4])
def test_harmonic_light_is_reproduced(degree):
    model, observation = harmonic_ball(degree)
    found = solve_harmonic(observation, model)
    error = (found.rendered - observation.pixels).abs().mean() / observation.pixels.mean()
    assert float(error) < 0.01
    # one of the modes, in the tone whose light is expected to be the least wrong
    safest = bayes_scale(scale_nll(MODES[:, None], tone_prior(ALBEDO_PRIOR)))
    assert ((MODES * safest[:, None] - found.albedo).abs() < 1e-5).all(1).any()
    # what albedo and light make together is theirs alone
    grid = DirectionGrid.latlong(found.environment.layout[0])
    radiance = harmonics.real_harmonics(grid.directions.numpy(), degree) @ harmonic_light(degree)
    assert radiance.min() > 0
    product = (found.albedo * found.environment.flat).double().numpy()
    np.testing.assert_allclose(product, MODES[1].double().numpy() * radiance, rtol=0.05)
    assert found.status == "converged"
    assert found.advice == ()
    again = solve_harmonic(observation, model)
    torch.testing.assert_close(again.params, found.params, rtol=1e-5, atol=1e-6)
    brighter = solve_harmonic(observation.scaled(8.0), model)
    torch.testing.assert_close(
        brighter.environment.radiance, 8 * found.environment.radiance, rtol=1e-3, atol=1e-3
    )


def test_harmonic_light_is_found_from_what_is_not_over_exposed():
    model, observation = harmonic_ball(2)
    level = luminance(observation.pixels)
    clipped = level > level.quantile(0.7)
    cut = torch.where(clipped[:, None], 0.5 * observation.pixels, observation.pixels)
    found = solve_harmonic(replace(observation, pixels=cut, clipped=clipped), model)
    torch.testing.assert_close(found.rendered, observation.pixels, rtol=0.02, atol=0.0)
    assert found.faces[0].residual < 0.01
    blind = solve_harmonic(replace(observation, pixels=cut), model)
    assert blind.faces[0].residual > 0.05


def test_harmonic_light_that_would_ring_is_held():
    """A fifth of a ball in the sun says little of the rest, where free coefficients swing."""
    places, normals = ball_normals()
    world = Outdoors([0.35, 0.9, 0.26], [1.0] * 3, [30.0] * 3, [0.3] * 3)
    shading = world.irradiance(normals) / math.pi
    noise = 1 + 0.05 * np.random.default_rng(1).standard_normal(shading.shape)
    whole = observed(MODES[1].double().numpy() * shading * noise, rows=32)
    seen = torch.from_numpy(places[:, 1] > np.quantile(places[:, 1], 0.8))
    observation = Observation(
        pixels=whole.pixels[seen],
        weights=whole.weights[seen],
        places=whole.places[seen],
        transport=TransportMatrix(matrix=whole.transport.matrix[seen], grid=whole.transport.grid),
    )
    transport = observation.transport
    basis = torch.from_numpy(harmonics.real_harmonics(transport.grid.directions.numpy(), 4))
    matrix, pixels = transport.matrix.double(), observation.pixels.double()
    free = basis @ torch.linalg.lstsq(matrix @ basis, pixels).solution
    assert free.min() < -0.05 * free.max()
    cut_off = residual(matrix @ free.clamp(min=0), pixels, None)
    found = solve_harmonic(observation, HarmonicLight(4, height=32))
    assert found.faces[0].residual < 0.05 < 0.5 * cut_off
    light = basis @ found.params.reshape(-1, 3).double()
    assert light.min() > -0.02 * light.max()


def test_a_sky_refuses_transport_on_other_rows():
    _, observation = harmonic_ball(2)
    problem = SkyProblem(SunSky(), SUNSKY_PRIOR, ALBEDO_PRIOR, MODES)
    with pytest.raises(InputError, match="needs transport of 64 rows"):
        problem.add(observation)


def test_harmonic_light_needs_a_pixel_that_is_not_over_exposed():
    model, observation = harmonic_ball(2)
    white = torch.ones(len(observation.pixels), dtype=torch.bool)
    with pytest.raises(InputError, match="whole face is over-exposed"):
        HarmonicProblem(model, ALBEDO_PRIOR, MODES).add(replace(observation, clipped=white))


def test_bounds_that_are_kept_leave_the_residual_alone():
    seen = torch.tensor([1.0, 2.0, 4.0, 4.0])[:, None].expand(-1, 3)
    rendered = torch.tensor([1.5, 2.0, 9.0, 3.0])[:, None].expand(-1, 3)
    clipped = torch.tensor([False, False, True, True])
    # 0.5, 0 and, from the bound that is not kept, 1 over a mean of 7 / 3
    assert residual(rendered, seen, clipped) == pytest.approx(1.5 / 7)
    assert residual(rendered[:3], seen[:3], clipped[:3]) == pytest.approx(0.5 / 3)
    assert residual(rendered, seen) == pytest.approx(6.5 / 11)
    assert residual(rendered[2:3], seen[2:3], clipped[2:3]) == 0
