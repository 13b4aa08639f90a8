"""Lamps from pictures of a ball, whose light is known: one, two, and one below the horizon."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.inverse._descent import Stage
from skylight.inverse._estimate import estimate_light
from skylight.inverse._faces import Level
from skylight.inverse._lamps import LampsOptions, LampsProblem
from skylight.inverse._problem import solve
from skylight.inverse._sun_prior import SunPart, SunPrior
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import DirectionGrid, angle_between
from tests.inverse.test_solve import ALBEDO_PRIOR, MODES, ball_normals, observed

ONE = (0.7, 0.4, 0.6)
QUICK = LampsOptions(
    scan_candidates=3,
    sets=3,
    coarse=(
        Stage(level=Level(2), starts=3, iterations=6, even_skin=True, steps="gauss-newton"),
        Stage(level=Level(1), starts=1, iterations=8, even_skin=True, steps="gauss-newton"),
    ),
)


def lit_ball(*lamps, ambient=0.4):
    """A ball of skin in even light and lamps (direction, energy), by transport on fine rows."""
    grid = DirectionGrid.latlong(64)
    radiance = torch.full((len(grid), 3), ambient, dtype=torch.float64)
    for direction, energy in lamps:
        towards = torch.tensor(direction, dtype=torch.float64)
        lobe = torch.exp(200 * (grid.directions @ (towards / towards.norm()) - 1))
        radiance += energy * (lobe / (lobe @ grid.solid_angles))[:, None]
    seen = observed(np.zeros((len(ball_normals()[0]), 3)))
    diffuse = seen.transport.matrix.double() @ radiance
    specular = seen.specular.matrix.double() @ radiance
    return observed((MODES[0].double() * diffuse + specular).numpy())


@cache
def found_in(*lamps):
    """The estimate of a ball in these lamps, made once for all tests that look at it."""
    return estimate_light(lit_ball(*lamps), "lamps")


def off_deg(estimate, direction):
    towards = torch.tensor(direction, dtype=torch.float64)
    return math.degrees(float(angle_between(estimate.direction, towards / towards.norm())))


@pytest.mark.parametrize(
    "direction",
    [
        ONE,
        *(
            pytest.param(one, marks=pytest.mark.slow)
            for one in [(-0.5, -0.6, 0.6), (0.1, 0.2, 1.0)]
        ),
    ],
)
def test_a_lamp_is_found_wherever_it_stands(direction):
    """Above and below the horizon, and near the camera."""
    found = found_in((direction, 3.0))
    main, *others = found.lamps
    assert off_deg(main, direction) < 4
    assert sum(float(lamp.irradiance.sum() / main.irradiance.sum()) for lamp in others) < 0.15
    assert found.faces[0].residual < 0.05
    assert found.posterior.is_seen
    towards = torch.tensor(direction, dtype=torch.float64)
    grid = found.posterior.grid
    assert grid.is_sphere
    assert bool(found.posterior.region[(grid.directions @ towards).argmax()])


def test_two_lamps_are_told_apart_and_strongest_first():
    one, two = (0.7, 0.3, 0.7), (-0.7, -0.5, 0.6)  # above and below the horizon
    found = estimate_light(lit_ball((one, 2.0), (two, 3.5)), "lamps")
    assert len(found.lamps) == 2
    assert off_deg(found.lamps[0], two) < 2
    assert off_deg(found.lamps[1], one) < 2
    strong, weak = (float(lamp.irradiance.mean()) for lamp in found.lamps)
    assert strong / weak == pytest.approx(3.5 / 2.0, rel=0.1)


def test_the_lamps_energies_are_in_the_map():
    found = found_in((ONE, 3.0))
    lamp, grid = found.lamps[0], found.environment.grid
    near = grid.directions @ lamp.direction > math.cos(4 * max(lamp.spread_rad, 0.05))
    cap = (found.environment.flat.double() * grid.solid_angles[:, None])[near].sum(0)
    around = found.environment.flat[~near].double().mean(0) * grid.solid_angles[near].sum()
    torch.testing.assert_close(cap - around, lamp.irradiance.double(), rtol=0.1, atol=0.05)


@pytest.mark.slow
def test_two_photographs_of_one_room_tell_of_one_light():
    """A ball in two exposures: the light is that of either, in the first one's units."""
    seen, alone = lit_ball((ONE, 3.0)), found_in((ONE, 3.0))
    problem = LampsProblem(ALBEDO_PRIOR, MODES, QUICK)
    problem.add(seen, 0)
    problem.add(seen.scaled(4.0), 1)
    (both,) = solve([problem])
    assert off_deg(both.lamps[0], ONE) < 4
    one, other = both.faces
    assert other.exposure / one.exposure == pytest.approx(4.0, rel=0.02)
    torch.testing.assert_close(
        both.lamps[0].irradiance.sum(), alone.lamps[0].irradiance.sum(), rtol=0.15, atol=0
    )


@pytest.mark.slow  # as of two photographs in different units
def test_the_unit_of_the_picture_is_that_of_the_light():
    """By a power of two, which rounds nothing; by others the lamp stays where it is.

    How far a search goes in a flat valley of brightness is chance, once anything is rounded.
    """
    found = found_in((ONE, 3.0))
    brighter = estimate_light(lit_ball((ONE, 3.0)).scaled(4.0), "lamps")
    torch.testing.assert_close(
        brighter.lamps[0].irradiance, 4 * found.lamps[0].irradiance, rtol=1e-6, atol=0
    )
    rounded = estimate_light(lit_ball((ONE, 3.0)).scaled(5.0), "lamps")
    assert off_deg(rounded.lamps[0], found.lamps[0].direction.tolist()) < 0.5


@pytest.mark.slow  # faces of grey pictures are tested with skies
def test_of_a_grey_picture_lamps_are_found_and_white():
    seen = lit_ball((ONE, 3.0))
    grey = luminance(seen.pixels)[:, None].expand(-1, 3)
    found = estimate_light(replace(seen, pixels=grey, grey=True), "lamps")
    assert off_deg(found.lamps[0], ONE) < 4
    irradiance = found.lamps[0].irradiance
    torch.testing.assert_close(irradiance / irradiance[1], torch.ones(3), atol=0.1, rtol=0)


@pytest.mark.slow
def test_what_is_clipped_is_a_lower_bound():
    """A fifth of the ball, round the brightest point, is clipped."""
    seen = lit_ball((ONE, 3.0))
    most = luminance(seen.pixels).quantile(0.8)
    clipped = luminance(seen.pixels) > most
    level = seen.pixels * (most / luminance(seen.pixels))[:, None]
    cut = replace(seen, pixels=torch.where(clipped[:, None], level, seen.pixels), clipped=clipped)
    found = estimate_light(cut, "lamps")
    assert off_deg(found.lamps[0], ONE) < 2
    unaware = estimate_light(replace(cut, clipped=None), "lamps")
    true, aware, without = (
        sum(float(lamp.irradiance.mean()) for lamp in one.lamps)
        for one in (found_in((ONE, 3.0)), found, unaware)
    )
    assert aware == pytest.approx(true, rel=0.1)
    assert without < 0.8 * true


def test_even_light_has_no_lamp():
    found = found_in()
    assert found.lamps == ()
    assert found.verdict.direction.word == "unknown"
    assert not found.posterior.is_seen


def test_lamps_do_not_follow_the_clock():
    part = SunPart(share=1.0, zenith_rad=0.5, azimuth_rad=0.0, turn=0.0)
    with pytest.raises(InputError, match="lamps are not the sun"):
        estimate_light(lit_ball(), "lamps", sun_prior=SunPrior(parts=(part,)))


def test_a_problem_without_faces_is_refused():
    with pytest.raises(InputError, match="no observation"):
        solve([LampsProblem(ALBEDO_PRIOR, MODES)])
