"""Lamps from pictures of a ball, whose light is known: one, two, and one below the horizon."""

import math

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.inverse.estimate import estimate_light
from skylight.inverse.lamps.problem import LampsProblem
from skylight.sphere.frame import angle_between
from skylight.sphere.grid import DirectionGrid
from tests.inverse.test_solve import ALBEDO_PRIOR, MODES, ball_normals, observed


def lit_ball(*lamps, ambient=0.4):
    """A ball of skin in even light and lamps (direction, energy), by transport on fine rows."""
    grid = DirectionGrid.latlong(64)
    radiance = torch.full((len(grid), 3), ambient, dtype=torch.float64)
    for direction, energy in lamps:
        towards = torch.tensor(direction, dtype=torch.float64)
        lobe = torch.exp(200 * (grid.directions @ (towards / towards.norm()) - 1))
        radiance += energy * (lobe / (lobe @ grid.solid_angles))[:, None]
    seen = observed(np.zeros((len(ball_normals()[0]), 3)))
    matt = seen.transport.matrix.double() @ radiance
    assert seen.gloss is not None
    gloss = seen.gloss.matrix.double() @ radiance
    return observed((MODES[0].double() * matt + gloss).numpy())


def off_deg(estimate, direction):
    towards = torch.tensor(direction, dtype=torch.float64)
    return math.degrees(float(angle_between(estimate.direction, towards / towards.norm())))


@pytest.mark.parametrize("direction", [(0.7, 0.4, 0.6), (-0.5, -0.6, 0.6), (0.1, 0.2, 1.0)])
def test_a_lamp_is_found_wherever_it_stands(direction):
    """Above and below the horizon, and near the camera."""
    found = estimate_light(lit_ball((direction, 3.0)), "lamps")
    main, *others = found.lamps
    assert off_deg(main, direction) < 4
    assert sum(float(lamp.irradiance.sum() / main.irradiance.sum()) for lamp in others) < 0.15
    assert found.faces[0].residual < 0.05
    towards = torch.tensor(direction, dtype=torch.float64)
    grid = found.posterior.grid
    assert grid.is_sphere
    assert bool(found.posterior.region[(grid.directions @ towards).argmax()])


def test_two_lamps_are_told_apart_and_strongest_first():
    one, two = (0.7, 0.3, 0.7), (-0.7, 0.5, 0.6)
    found = estimate_light(lit_ball((one, 2.0), (two, 3.5)), "lamps")
    assert len(found.lamps) == 2
    assert off_deg(found.lamps[0], two) < 2
    assert off_deg(found.lamps[1], one) < 2
    strong, weak = (float(lamp.irradiance.mean()) for lamp in found.lamps)
    assert strong / weak == pytest.approx(3.5 / 2.0, rel=0.1)


def test_the_lamps_energies_are_in_the_map():
    found = estimate_light(lit_ball(((0.7, 0.4, 0.6), 3.0)), "lamps")
    lamp, grid = found.lamps[0], DirectionGrid.latlong(64)
    near = grid.directions @ lamp.direction > math.cos(4 * max(lamp.spread_rad, 0.05))
    cap = (found.environment.flat.double() * grid.solid_angles[:, None])[near].sum(0)
    around = found.environment.flat[~near].double().mean(0) * grid.solid_angles[near].sum()
    torch.testing.assert_close(cap - around, lamp.irradiance.double(), rtol=0.1, atol=0.05)


def test_even_light_has_no_lamp():
    found = estimate_light(lit_ball(), "lamps")
    assert found.posterior.verdict == "even: no lamp"
    assert not found.posterior.is_seen


def test_a_problem_without_faces_is_refused():
    with pytest.raises(InputError, match="no observation"):
        LampsProblem(ALBEDO_PRIOR, MODES).solve()
