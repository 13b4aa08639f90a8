"""The solvers on pictures of a ball whose light is known."""

import copy
import math
from dataclasses import replace

import pytest
import torch

from skylight.errors import InputError
from skylight.faces.skin import SkinPrior
from skylight.inverse import harmonic
from skylight.inverse.estimate import residual
from skylight.inverse.harmonic import HarmonicProblem
from skylight.inverse.objective import (
    FaceTerm,
    SkyObjective,
    least_wrong_scale,
    scale_rarity,
    tone_prior,
)
from skylight.inverse.solve import Round, SkyProblem, SolverOptions, solve_sky
from skylight.models.harmonic import HarmonicLight
from skylight.models.shipped import sunsky_light, sunsky_prior
from skylight.sphere.envmap import luminance
from skylight.sphere.frame import direction_from_angles
from skylight.sphere.grid import DirectionGrid
from skylight.transport.gloss import glossy_transport
from skylight.transport.matrix import TransportMatrix
from skylight.transport.observation import Observation
from skylight.transport.render import Specular

SKIN = SkinPrior.load()
# a copy: the prior is loaded once a process, and .float() changes a module in place
ALBEDO_PRIOR = copy.deepcopy(SKIN.log_albedo).float()
MODES = SKIN.means.float()
# (azimuth, zenith angle) in degrees; the camera looks along azimuth 0
SUNS = [(140.0, 40.0), (-110.0, 60.0), (170.0, 20.0)]


def ball(side=20, rows=64):
    """A matt and a glossy transport of the near half of a ball, seen from afar."""
    line = (torch.arange(side) + 0.5) / side * 2 - 1
    y, x = torch.meshgrid(-line, line, indexing="ij")
    inside = x**2 + y**2 < 0.95
    places = torch.nonzero(inside)
    x, y = x[inside], y[inside]
    normals = torch.stack([x, y, (1 - x**2 - y**2).sqrt()], 1)
    grid = DirectionGrid.latlong(rows)
    cosine = (normals.double() @ grid.directions.T).clamp(min=0)
    matrix = (cosine * grid.solid_angles / math.pi).float()
    transport = TransportMatrix(matrix=matrix, grid=grid)
    views = torch.tensor([0.0, 0.0, 1.0]).expand_as(normals)
    return transport, glossy_transport(transport, normals, views, Specular()), places


def watched(azimuth, zenith):
    """An observation made by the model itself: (observation, true direction of the sun)."""
    transport, gloss, places = ball()
    model = sunsky_light()
    angles = torch.tensor([[math.radians(azimuth), math.radians(zenith)]])
    colours = torch.tensor([[0.45, 0.55, 0.8, 5.5, 5.0, 4.2]])
    light = torch.cat([colours, angles, torch.tensor([[3.5, 700.0]])], 1)
    blank = Observation(
        pixels=torch.ones(len(places), 3),
        weights=torch.ones(len(places)),
        places=places,
        transport=transport,
        gloss=gloss,
    )
    objective = SkyObjective(
        [FaceTerm.of(blank)], model, sunsky_prior(), ALBEDO_PRIOR, SolverOptions().weights
    )
    ground = torch.tensor([[0.15, 0.13, 0.11]])
    free = objective.pack(light, torch.tensor([[2.5]]), torch.ones(1, 1), MODES[:1, None], ground)
    with torch.no_grad():
        pixels = objective.shading(objective.unpack(free))[0][0]
    observation = Observation(
        pixels=pixels, weights=blank.weights, places=places, transport=transport, gloss=gloss
    )
    return observation, direction_from_angles(*angles[0].double())


def rounds(*iterations):
    """So many iterations on each level, the coarsest first."""
    return tuple(
        Round(level=3 - k, starts=2 if k == 0 else 1, iterations=count)
        for k, count in enumerate(iterations)
    )


def solved(observation, prior=None, **options):
    return solve_sky(
        observation,
        sunsky_light(),
        prior or sunsky_prior(),
        ALBEDO_PRIOR,
        MODES,
        SolverOptions(**options),
    )


@pytest.fixture(scope="module")
def first():
    observation, _ = watched(*SUNS[0])
    return observation, solved(observation)


@pytest.mark.parametrize("sun", SUNS)
def test_the_sun_is_found_again(sun):
    observation, direction = watched(*sun)
    found = solved(observation)
    angle = math.degrees(math.acos(min(1.0, float(found.sun_direction.double() @ direction))))
    assert angle < 3
    error = (found.rendered - observation.pixels).abs().mean() / observation.pixels.mean()
    assert float(error) < 0.04  # below the noise that the objective expects
    assert found.advice == ()


def test_an_estimate_is_in_itself_consistent(first):
    observation, found = first
    assert found.light == "sunsky"
    assert found.environment.layout == (64, 128)
    assert (found.environment.radiance >= 0).all()
    # the picture again from the map: exposure and units are in it
    flat = found.environment.flat
    rendered = found.albedo * (observation.transport.matrix @ flat)
    assert observation.gloss is not None
    rendered = rendered + found.faces[0].gloss * (observation.gloss.matrix @ flat)
    torch.testing.assert_close(rendered, found.rendered, rtol=1e-4, atol=1e-5)
    sky = sunsky_light().radiance(found.params[None])[0] * found.exposure
    torch.testing.assert_close(sky, found.environment.upper().flat, rtol=1e-4, atol=1e-5)
    assert found.environment.radiance[32:].reshape(-1, 3).std(0).max() < 1e-5  # one ground
    low, high = sunsky_light().bounds
    assert ((found.params >= low) & (found.params <= high)).all()


def test_the_same_picture_gives_the_same_light(first):
    observation, found = first
    again = solved(observation)
    assert torch.equal(again.params, found.params)
    assert torch.equal(again.environment.radiance, found.environment.radiance)
    assert (again.terms, again.stats, again.status) == (found.terms, found.stats, found.status)


def test_a_brighter_exposure_changes_only_the_exposure(first):
    observation, found = first
    brighter = solved(observation.scaled(4.0))  # a power of two: the same roundings
    torch.testing.assert_close(brighter.params, found.params)
    assert brighter.exposure == pytest.approx(4 * found.exposure)
    torch.testing.assert_close(brighter.environment.radiance, 4 * found.environment.radiance)


def test_the_status_tells_how_it_ended(first):
    observation, _ = first
    patient = solved(observation, rounds=rounds(5, 5, 5, 200), tolerance=1e-3)
    assert patient.status == "converged"
    assert solved(observation, rounds=rounds(2, 1, 1, 1), tolerance=0.0).status == "iteration limit"

    class Flaw:
        """A prior that is not a number once, on the first step after the start."""

        calls = 0

        def log_prob(self, x):
            self.calls += 1
            value = sunsky_prior().log_prob(x)
            return value * torch.nan if self.calls == 2 else value

        def sample(self, count, generator):
            return sunsky_prior().sample(count, generator)

    # without tolerance it cannot converge, so the flaw is what the status has to tell
    flawed = solved(observation, Flaw(), rounds=rounds(3, 1, 1, 1), tolerance=0.0)
    assert flawed.status == "recovered from a non-finite step"
    assert flawed.stats["nonfinite"] > 0
    assert flawed.environment.radiance.isfinite().all()
    assert math.isfinite(sum(flawed.terms.values()))


def test_progress_rises_to_one(first):
    told = []
    solve_sky(
        first[0],
        sunsky_light(),
        sunsky_prior(),
        ALBEDO_PRIOR,
        MODES,
        SolverOptions(rounds=rounds(1, 1, 1, 1)),
        told.append,
    )
    assert told == sorted(told)
    assert told[-1] == 1


def test_pictures_that_no_light_explains_come_with_advice(first):
    observation, _ = first
    checks = 0.2 + 1.6 * (observation.places.sum(1) % 2).float()
    spoilt = Observation(
        pixels=observation.pixels * checks[:, None],
        weights=observation.weights,
        places=observation.places,
        transport=observation.transport,
    )
    (advice,) = solved(spoilt, rounds=rounds(3, 3, 3, 3)).advice
    assert "unreliable" in advice


def harmonic_ball(degree):
    """A light model, and a ball in a light of that model."""
    transport, _, places = ball(rows=32)
    model = HarmonicLight(degree, height=32)
    generator = torch.Generator().manual_seed(degree)
    coefficients = 0.15 * torch.randn((degree + 1) ** 2, 3, generator=generator)
    coefficients[0] = 4.0
    light = model.radiance(coefficients.reshape(1, -1))[0]
    assert (light > 0).all()
    observation = Observation(
        pixels=MODES[1] * (transport.matrix @ light),
        weights=torch.ones(len(places)),
        places=places,
        transport=transport,
    )
    return model, observation


def solve_harmonic(observation, model):
    problem = HarmonicProblem(model, ALBEDO_PRIOR, MODES)
    problem.add(observation)
    return problem.solve()


@pytest.mark.parametrize("degree", [2, 4])
def test_harmonic_light_is_reproduced(degree):
    model, observation = harmonic_ball(degree)
    found = solve_harmonic(observation, model)
    error = (found.rendered - observation.pixels).abs().mean() / observation.pixels.mean()
    assert float(error) < 0.01
    # one of the modes, in the tone whose light is expected to be the least wrong
    safest = least_wrong_scale(scale_rarity(MODES[:, None], tone_prior(ALBEDO_PRIOR)))
    assert ((MODES * safest[:, None] - found.albedo).abs() < 1e-5).all(1).any()
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


def test_harmonic_light_that_would_ring_is_held(monkeypatch):
    """A fifth of a ball in the sun says little of the rest, where free coefficients swing."""
    transport, _, places = ball(rows=32)
    sun = torch.zeros(32, 64)
    sun[8, 20] = 300.0
    light = (sun + 0.3).reshape(-1, 1).expand(-1, 3)
    seen = places[:, 1] > places[:, 1].double().quantile(0.8)
    shading = transport.matrix[seen] @ light
    noise = 1 + 0.05 * torch.randn(shading.shape, generator=torch.Generator().manual_seed(1))
    observation = Observation(
        pixels=MODES[1] * shading * noise,
        weights=torch.ones(int(seen.sum())),
        places=places[seen],
        transport=TransportMatrix(matrix=transport.matrix[seen], grid=transport.grid),
    )
    held = solve_harmonic(observation, HarmonicLight(4, height=32)).faces[0].residual
    monkeypatch.setattr(harmonic, "RIDGES", (1e-6,))
    free = solve_harmonic(observation, HarmonicLight(4, height=32)).faces[0].residual
    assert held < 0.8 * free


def test_a_sky_refuses_transport_on_other_rows():
    _, observation = harmonic_ball(2)
    problem = SkyProblem(sunsky_light(), sunsky_prior(), ALBEDO_PRIOR, MODES)
    with pytest.raises(ValueError, match="needs transport of 64 rows"):
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
