"""Laplace's approximation of the evidence against importance sampling of the integral itself."""

import math
from dataclasses import replace
from functools import cache

import pytest
import torch

from skylight.inverse._descent import Iterates, Stage, descend
from skylight.inverse._faces import FaceTerm, Level, ObjectiveWeights
from skylight.inverse._objective import LightObjective
from skylight.inverse._solution import Solutions, log_evidence
from skylight.models._lamps import AMBIENT_PARAMETERS, LampsLight, LampsPrior
from skylight.models._prior import GaussianMixture
from tests.inverse.test_objective import ROWS, normal, observation

pytestmark = pytest.mark.usefixtures("double")
DEGREES_OF_FREEDOM = 8.0


@cache
def under_a_lamp(noise):
    """(objective, its minimum) of pixels in the light of one lamp, with noise."""
    model, seen = LampsLight(1, 2 * ROWS), observation()

    def objective(pixels):
        term = FaceTerm.of(replace(seen, pixels=pixels), sphere=True)
        return LightObjective([term], model, LampsPrior(1), normal(3), ObjectiveWeights())

    generator = torch.Generator().manual_seed(5)
    known = objective(seen.pixels)
    truth = 0.3 * torch.randn(1, known.size, generator=generator)
    truth[:, AMBIENT_PARAMETERS : AMBIENT_PARAMETERS + 3] = torch.tensor([0.5, 0.5, 0.7])
    pixels = known.shading(known.unpack(truth))[0][0]
    pixels = pixels * (1 + noise * torch.randn(pixels.shape, generator=generator))
    noisy = objective(pixels)
    start = Iterates(free=truth, scores=noisy(truth), converged=torch.tensor([False]))
    (end,) = descend(
        noisy, [start], Stage(level=Level(0), starts=1, iterations=60, steps="gauss-newton"), 1e-9
    )
    return noisy, end.free


def sampled(objective, minimum, count=10_000):
    """log int exp(-f), by draws from Student's t about the minimum, as wide as f is there."""
    size = objective.size
    slope = torch.autograd.functional.hessian(lambda x: objective(x[None])[0], minimum[0])
    values, vectors = torch.linalg.eigh(slope)
    values = values.clamp(min=1.0)
    generator = torch.Generator().manual_seed(0)
    normal_draws = torch.randn(count, size, generator=generator)
    squares = torch.randn(count, int(DEGREES_OF_FREEDOM), generator=generator).square().sum(1)
    draws = normal_draws * (DEGREES_OF_FREEDOM / squares).sqrt()[:, None]
    points = minimum + draws @ (vectors / values.sqrt()).T
    half = (DEGREES_OF_FREEDOM + size) / 2
    log_density = (
        math.lgamma(half)
        - math.lgamma(DEGREES_OF_FREEDOM / 2)
        - size / 2 * math.log(DEGREES_OF_FREEDOM * math.pi)
        + 0.5 * values.log().sum()
        - half * torch.log1p(draws.square().sum(1) / DEGREES_OF_FREEDOM)
    )
    with torch.no_grad():
        losses = torch.cat([objective(block) for block in points.split(3_000)])
    return float((-losses - log_density).logsumexp(0)) - math.log(count)


@pytest.mark.parametrize("noise", [0.02, pytest.param(0.06, marks=pytest.mark.slow)])
def test_it_is_the_integral_over_all_unknowns(noise):
    objective, minimum = under_a_lamp(noise)
    assert float(log_evidence(objective, minimum)) == pytest.approx(
        sampled(objective, minimum), abs=7
    )


def test_more_unknowns_than_the_pixels_tell_of_cost():
    """A lamp more, of next to no energy, changes no pixel: its prior's volume is lost."""
    objective, minimum = under_a_lamp(0.02)
    lamp = torch.tensor([[0.0, 1.0, 0.5, -5.0, 0.0, 0.0, 0.0]])
    light, rest = minimum.tensor_split([objective.model.parameter_count], 1)
    (face,) = objective.faces
    two = LightObjective(
        [face], LampsLight(2, 2 * ROWS), LampsPrior(2), objective.albedo_prior, objective.weights
    )
    more = torch.cat([light, lamp, rest], 1)
    assert float(log_evidence(two, more)) < float(log_evidence(objective, minimum)) - 5


def test_brightness_is_as_sure_as_the_albedo_that_divides_it():
    """An albedo that is known within 2 % leaves less than 5 % of doubt about the light's level."""
    objective, minimum = under_a_lamp(0.02)
    ends = [Iterates(free=minimum, scores=objective(minimum), converged=torch.tensor([True]))]
    (free,) = Solutions.of(objective, ends).spreads
    known = objective.unpack(minimum).albedo[0, 0].log()
    prior = GaussianMixture(torch.ones(1), known[None], torch.eye(3)[None] / 0.02)
    objective = LightObjective(
        objective.faces, objective.model, objective.light_prior, prior, objective.weights
    )
    (held,) = Solutions.of(objective, ends).spreads
    assert held.level < 0.05 < 0.2 < free.level
    assert held.tint < free.tint
