"""The light on points of a known head: facts, laws, and the evidence by dense matrices."""

import math

import numpy as np
import pytest
import torch
from scipy.stats import norm

from skylight.faces._skin import SkinPrior
from skylight.live._prior import ambient_moments, shape_errors
from skylight.live._solve import (
    LAMP_SPREAD,
    LEVELS,
    LightSolution,
    LightSolver,
    head_from_camera,
)
from skylight.sphere._harmonics import evaluate
from tests.live.heads import ALBEDO, angle_deg, facing_weights, lit, mean_skin, turned

MAIN, AMBIENT = np.array([2.4, 2.1, 1.6]), np.array([0.25, 0.3, 0.4])
OTHER_SKIN = ALBEDO / SkinPrior.load().mean.numpy()


def unit(*direction: float) -> np.ndarray:
    return np.array(direction) / np.linalg.norm(direction)


def found(colours: np.ndarray, rotation: np.ndarray, *, scale: float = 1.0) -> LightSolution:
    return LightSolver(mean_skin()).solve(scale * colours, facing_weights(rotation), rotation)


@pytest.mark.parametrize("yaw", [0.0, 30.0])
@pytest.mark.parametrize(
    "towards",
    [
        unit(0, 0.3, 1),
        unit(1, 0.5, 0.4),
        unit(-1, 0.2, 0.5),
        unit(0.3, 1, 0.5),
        unit(-0.8, 0, -0.3),
    ],
    ids=["front", "left", "right", "above", "behind"],
)
def test_one_lamp_is_found_where_it_is(towards: np.ndarray, yaw: float) -> None:
    """Within 6.5 degrees (a cell is 5.6 wide), and no surer than that; strength and ambient light
    to four tenths, of the light that the mean person would need to look so.

    That a light is in front is only known from how dark the sides are: the radius is large.
    """
    rotation = turned(yaw, 5.0)
    light = found(lit(towards, MAIN, AMBIENT), rotation)
    error = angle_deg(light.direction, rotation @ towards)
    assert error < 6.5
    assert error < math.degrees(light.radius_90_rad) < (35 if towards[2] < 0.9 else 180)
    np.testing.assert_allclose(light.irradiance, OTHER_SKIN * MAIN, rtol=0.4)
    mean_radiance = light.ambient[0] * 0.5 / math.sqrt(math.pi)
    np.testing.assert_allclose(mean_radiance, OTHER_SKIN * AMBIENT, rtol=0.4)


def test_even_light_has_no_direction_and_its_own_radiance() -> None:
    rotation = turned(10.0)
    light = found(lit(unit(0, 0, 1), 0 * MAIN, AMBIENT), rotation)
    assert math.degrees(light.radius_90_rad) > 60
    mean_radiance = light.harmonics[0] * 0.5 / math.sqrt(math.pi)
    np.testing.assert_allclose(mean_radiance, OTHER_SKIN * AMBIENT, rtol=0.5)


def test_the_light_turns_with_the_head_about_the_vertical() -> None:
    """By the prior, light is alike all round; above and below it is not."""
    colours, weights = lit(unit(1, 0.5, 0.6), MAIN, AMBIENT), facing_weights(turned(0.0))
    one = LightSolver(mean_skin()).solve(colours, weights, turned(0.0))
    turn = turned(70.0)
    other = LightSolver(mean_skin()).solve(colours, weights, turn)
    # float32 within, and 300 draws of places are alike all round to a few hundredths only
    assert angle_deg(other.direction, turn @ one.direction) < 1
    basis = evaluate(mean_skin().grid.directions, 2).numpy()
    ahead = evaluate(
        mean_skin().grid.directions @ torch.from_numpy(turn), 2
    ).numpy()  # L'(w) = L(R^T w)
    apart = basis @ other.harmonics - ahead @ one.harmonics
    assert np.sqrt((apart**2).mean()) < 0.1 * np.sqrt(((ahead @ one.harmonics) ** 2).mean())


def test_twice_the_exposure_is_twice_the_light_from_the_same_direction() -> None:
    rotation = turned(-20.0)
    colours = lit(unit(-1, 0.8, 0.6), MAIN, AMBIENT)
    one, twice = found(colours, rotation), found(colours, rotation, scale=2.0)
    np.testing.assert_allclose(twice.direction, one.direction, atol=1e-5)
    np.testing.assert_allclose(twice.radius_90_rad, one.radius_90_rad, atol=1e-4)
    np.testing.assert_allclose(twice.harmonics, 2 * one.harmonics, rtol=1e-4, atol=1e-4)


def test_colours_of_light_are_told_apart() -> None:
    """A red lamp in blue ambient light."""
    main, ambient = np.array([3.0, 1.0, 0.5]), np.array([0.2, 0.4, 0.8])
    light = found(lit(unit(1, 0.5, 0.5), main, ambient), turned(0.0))
    assert light.irradiance[0] / OTHER_SKIN[0] > 1.5 * light.irradiance[1] / OTHER_SKIN[1]
    red, green, blue = light.ambient[0] / OTHER_SKIN
    assert 1.5 * red < green < blue / 1.5


def test_a_beard_does_not_move_the_lamp() -> None:
    towards, rotation = unit(1, 0.4, 0.7), turned(0.0)
    colours = lit(towards, MAIN, AMBIENT)
    chin = mean_skin().positions[:, 1] < np.quantile(mean_skin().positions[:, 1], 0.15)
    colours[chin] *= 0.25
    assert angle_deg(found(colours, rotation).direction, rotation @ towards) < 7


def test_turning_harmonics_is_orthogonal_and_turns_light() -> None:
    rotation = turned(25.0, -10.0, 5.0)
    turning = head_from_camera(rotation)
    np.testing.assert_allclose(turning @ turning.T, np.eye(25), atol=1e-12)
    camera = np.random.default_rng(0).standard_normal(25)
    directions = mean_skin().grid.directions[::97]
    ahead = evaluate(directions @ torch.from_numpy(rotation.T.copy()), 4).numpy() @ camera
    np.testing.assert_allclose(
        evaluate(directions, 4).numpy() @ turning @ camera, ahead, atol=1e-12
    )


@pytest.mark.parametrize("share", LEVELS)
def test_all_of_a_level_is_that_of_dense_matrices(share: float) -> None:
    """Of 40 directions, ln N(z; 0, K + s^2 t t^T) 2 Phi(m / v), the mean of E and, given that, the
    ambient light b mu + b^2 S B^T K^-1 (z - E t), which with the lamp makes the shading."""
    rotation, towards = turned(15.0), unit(0.9, 0.5, 0.6)
    colours, weights = lit(towards, MAIN, AMBIENT), facing_weights(rotation)
    y = np.repeat((colours @ [0.2126, 0.7152, 0.0722])[:, None], 4, axis=1)
    y /= weights @ y[:, 0] / weights.sum()
    solver = LightSolver(mean_skin())
    problem = solver.problem(y, weights, head_from_camera(rotation))
    used = weights > 0
    level = problem.at(share)
    mean, root = ambient_moments()
    whole_basis = mean_skin().transport @ evaluate(mean_skin().grid.directions, 4).numpy()
    turning = head_from_camera(rotation)
    basis = whole_basis[used] @ turning
    b = share / problem.even_level
    z = y[used, 0] - b * basis @ mean
    covariance = b**2 * basis @ root @ root.T @ basis.T + np.diag(1 / problem.precision[used])
    errors = problem.ways[used][:, len(mean) :]
    covariance += errors @ errors.T
    np.testing.assert_array_equal(errors[:, -24:], shape_errors()[used])
    picked = np.random.default_rng(1).choice(2048, 40, replace=False)
    for d in picked:
        t = problem.towards[used, d].astype(np.float64)
        whole = covariance + LAMP_SPREAD**2 * np.outer(t, t)
        weight = LAMP_SPREAD**2 * t @ np.linalg.inv(whole)
        m, v = weight @ z, LAMP_SPREAD * math.sqrt(max(1 - weight @ t, 1e-12))
        density = -0.5 * (z @ np.linalg.solve(whole, z) + np.linalg.slogdet(whole)[1])
        log = density + norm.logcdf(m / v)
        first = picked[0]
        if d == first:
            constant = level.evidence[d] - log
        assert level.evidence[d] - log == pytest.approx(constant, abs=0.05)
        truncated = m + v * math.exp(norm.logpdf(m / v) - norm.logcdf(m / v))
        assert level.strength[0, d] == pytest.approx(truncated, rel=0.02, abs=0.01)
        shares = np.zeros((2048, 4))
        shares[d] = 1
        main, ambient, shading, left = level.explained(shares)
        rest = np.linalg.solve(covariance, z - main[d, 0] * t)
        mean_ambient = turning @ (b * mean + b**2 * root @ root.T @ basis.T @ rest)
        np.testing.assert_allclose(ambient[:, 0], mean_ambient, atol=1e-3 * abs(mean_ambient[0]))
        np.testing.assert_allclose(
            whole_basis @ ambient[:, 0] + main[d, 0] * problem.towards[:, d], shading, atol=1e-5
        )
        np.testing.assert_allclose(left[used], rest / problem.precision[used], atol=1e-3)
