"""The smoother against one dense least-squares problem, and against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from skylight.estimation.film._smoother import Drifting, Sight, covariance_of, likeliest, smooth

DRIFT, NOISE = 0.3, 1.7


def example(seed: int = 0) -> tuple[Drifting, list[Sight]]:
    """Four unknowns, one of which stands still; five sights of one to four numbers."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(4, 4))
    model = Drifting(
        mean=rng.normal(size=4),
        covariance=root @ root.T + np.eye(4),
        times_s=np.array([0.0, 0.5, 0.7, 2.0, 3.5]),
        scale=np.array([1.0, 0.5, 2.0, 0.0]),
    )
    sights = [
        Sight(matrix=rng.normal(size=(m, 4)), value=rng.normal(size=m)) for m in (2, 4, 1, 3, 2)
    ]
    return model, sights


def dense(model: Drifting, sights: list[Sight]) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean and covariance of all unknowns at once, and the evidence, from the joint normal."""
    count, n = len(sights), len(model.mean)
    since = model.times_s - model.times_s[0]
    joint = np.zeros((count * n, count * n))
    for j in range(count):
        for k in range(count):
            shared = model.covariance + np.diag(model.scale * DRIFT * min(since[j], since[k]))
            joint[j * n : (j + 1) * n, k * n : (k + 1) * n] = shared
    rows = sum(len(sight.value) for sight in sights)
    matrix, row = np.zeros((rows, count * n)), 0
    for k, sight in enumerate(sights):
        matrix[row : row + len(sight.value), k * n : (k + 1) * n] = sight.matrix
        row += len(sight.value)
    value = np.concatenate([sight.value for sight in sights])
    mean = np.tile(model.mean, count)
    spread = matrix @ joint @ matrix.T + NOISE * np.eye(rows)
    gain = joint @ matrix.T @ np.linalg.inv(spread)
    found = mean + gain @ (value - matrix @ mean)
    evidence = multivariate_normal(matrix @ mean, spread).logpdf(value)
    return found.reshape(count, n), joint - gain @ matrix @ joint, float(evidence)


def test_it_is_the_joint_posterior_of_all_times() -> None:
    model, sights = example()
    found = smooth(model, sights, drift=DRIFT, noise=NOISE)
    means, covariance, evidence = dense(model, sights)
    np.testing.assert_allclose(found.means, means, atol=1e-9)
    for k, own in enumerate(found.covariances):
        block = covariance[4 * k : 4 * k + 4, 4 * k : 4 * k + 4]
        np.testing.assert_allclose(own, block, atol=1e-9)
    assert found.log_evidence == pytest.approx(evidence, abs=1e-8)


def test_what_stands_still_is_the_same_at_all_times() -> None:
    model, sights = example(1)
    still = smooth(model, sights, drift=DRIFT).means[:, 3]
    np.testing.assert_allclose(still, still[0], atol=1e-9)
    constant = smooth(model, sights, drift=0.0).means
    np.testing.assert_allclose(constant, np.tile(constant[0], (5, 1)), atol=1e-9)


def test_one_sight_is_bayes_rule() -> None:
    """A prior of variance 4 about 1, seen at 3 with a variance of 1: 13/5, of variance 4/5."""
    model = Drifting(
        mean=np.array([1.0]),
        covariance=np.array([[4.0]]),
        times_s=np.zeros(1),
        scale=np.ones(1),
    )
    found = smooth(model, [Sight(matrix=np.eye(1), value=np.array([3.0]))], drift=1.0)
    assert found.means[0, 0] == pytest.approx(13 / 5)
    assert found.covariances[0, 0, 0] == pytest.approx(4 / 5)
    expected = -0.5 * (4 / 5 + math.log(2 * math.pi * 5))
    assert found.log_evidence == pytest.approx(expected)


def test_a_sight_of_a_minimum_has_its_slope_and_hessian() -> None:
    rng = np.random.default_rng(2)
    root = rng.normal(size=(3, 5))  # of rank 3: two directions are not told
    hessian, at = root.T @ root, rng.normal(size=5)
    slope = hessian @ rng.normal(size=5)
    sight = Sight.of_minimum(at, slope, hessian)
    assert sight.matrix.shape == (3, 5)
    np.testing.assert_allclose(sight.matrix.T @ sight.matrix, hessian, atol=1e-9)
    gap = sight.matrix @ at - sight.value
    np.testing.assert_allclose(sight.matrix.T @ gap, slope, atol=1e-9)


@pytest.mark.parametrize(("drift", "noise"), [(1e-4, 1.0), (1e-9, 4.0)])
def test_drift_and_noise_are_told_by_the_data(drift: float, noise: float) -> None:
    """Six unknowns at 120 times, drawn from the model."""
    rng = np.random.default_rng(3)
    times = np.arange(120) * 100.0
    steps = rng.normal(0, math.sqrt(100 * drift), (120, 6))
    truth = rng.normal(size=6) + np.cumsum(steps, 0)
    sights = [
        Sight(matrix=2 * np.eye(6), value=2 * x + rng.normal(0, math.sqrt(noise), 6)) for x in truth
    ]
    model = Drifting(mean=np.zeros(6), covariance=np.eye(6), times_s=times, scale=np.ones(6))
    found_drift, found_noise = likeliest(model, sights)
    assert found_noise == pytest.approx(noise, rel=0.15)
    assert found_drift < 1e-6 if drift < 1e-6 else found_drift == pytest.approx(drift, rel=0.35)


def test_a_rounded_precision_gives_a_covariance() -> None:
    """A Hessian in float32, some of whose unknowns are hardly told: a sharp sight still filters."""
    rng = np.random.default_rng(0)
    root = np.linalg.qr(rng.normal(size=(90, 90)))[0]
    precision = root * np.geomspace(1e-3, 100, 90) @ root.T
    rounded = precision + 1e-5 * rng.normal(size=precision.shape)
    covariance = covariance_of(rounded)
    np.testing.assert_array_equal(covariance, covariance.T)
    sights = [Sight(matrix=70 * np.eye(90), value=np.zeros(90))]
    model = Drifting(
        mean=np.zeros(90), covariance=covariance, times_s=np.zeros(1), scale=np.ones(90)
    )
    exact = smooth(
        replace(model, covariance=np.linalg.inv(precision)), sights, drift=0.0, noise=0.1
    )
    found = smooth(model, sights, drift=0.0, noise=0.1)
    np.testing.assert_allclose(found.covariances, exact.covariances, atol=1e-6)
    uneven = replace(model, covariance=np.linalg.inv(rounded))
    with pytest.raises(np.linalg.LinAlgError):  # what the rounding would do
        smooth(uneven, sights, drift=0.0, noise=0.1)
