from dataclasses import dataclass

import numpy as np
import pytest
import torch
from scipy.optimize import nnls
from sklearn.linear_model import Lasso

from skylight.csc._least_squares import (
    ActiveSet,
    CholeskyFactor,
    LinearObservation,
    Quadratic,
    SampledSignal,
)
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._latlong_transform import LatLongTransform
from tests.csc.draws import F64, random

SAMPLES = 40


def problem(atoms: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Atoms that look alike, as neighbouring filters do, and a signal of signs mixed."""
    draw = np.random.default_rng(seed)
    shared = draw.standard_normal((SAMPLES, 1))
    matrix = draw.standard_normal((SAMPLES, atoms)) + shared
    return matrix, matrix[:, ::3].sum(1) - matrix[:, 1::3].sum(1) + draw.standard_normal(SAMPLES)


def lasso(matrix: np.ndarray, signal: np.ndarray, penalty: float, positive: bool) -> np.ndarray:
    model = Lasso(
        alpha=penalty / len(signal),
        fit_intercept=False,
        positive=positive,
        tol=1e-14,
        max_iter=1_000_000,
    )
    return model.fit(matrix, signal).coef_


def expected_weights(
    matrix: np.ndarray, signal: np.ndarray, penalty: float, nonnegative: bool
) -> np.ndarray:
    if penalty > 0:
        return lasso(matrix, signal, penalty, nonnegative)
    if nonnegative:
        return nnls(matrix, signal)[0]
    return np.linalg.lstsq(matrix, signal, rcond=None)[0]


FITS = [(0.0, False), (0.0, True), (5.0, False), (5.0, True), (60.0, False), (60.0, True)]


@pytest.mark.parametrize(("penalty", "nonnegative"), FITS)
@pytest.mark.parametrize("seed", range(3))
def test_optimal_while_atoms_come_and_go(penalty: float, nonnegative: bool, seed: int) -> None:
    matrix, signal = problem(20, seed)
    active = ActiveSet(penalty=penalty, nonnegative=nonnegative)
    draw = np.random.default_rng(seed)
    present: list[int] = []
    for new in range(20):
        active.grow()
        present.append(new)
        if new % 4 == 3:  # used or not, in the middle or at the end
            gone = int(draw.integers(len(present)))
            active.drop(gone)
            del present[gone]
        here = matrix[:, present]
        found = active.solve(here.T @ here, here.T @ signal)
        expected = expected_weights(here, signal, penalty, nonnegative)
        np.testing.assert_allclose(found, expected, atol=1e-7, rtol=0)
        assert found is active.weights


@pytest.mark.parametrize(("penalty", "nonnegative"), FITS)
def test_all_atoms_at_once(penalty: float, nonnegative: bool) -> None:
    matrix, signal = problem(25, seed=4)
    active = ActiveSet(penalty=penalty, nonnegative=nonnegative)
    for _ in range(25):
        active.grow()
    found = active.solve(matrix.T @ matrix, matrix.T @ signal)
    expected = expected_weights(matrix, signal, penalty, nonnegative)
    np.testing.assert_allclose(found, expected, atol=1e-7, rtol=0)


@pytest.mark.parametrize(("penalty", "nonnegative"), FITS)
def test_dependent_atoms_do_no_harm(penalty: float, nonnegative: bool) -> None:
    """Twins, a negative, a sum, a zero: some weights of the best fit are found."""
    matrix, signal = problem(8, seed=5)
    sums = np.stack([matrix[:, 0], -matrix[:, 1], matrix[:, 2] + matrix[:, 3], 0 * signal], 1)
    matrix = np.concatenate([matrix, sums, matrix[:, :4]], 1)
    active = ActiveSet(penalty=penalty, nonnegative=nonnegative)
    for count in range(1, matrix.shape[1] + 1):
        active.grow()
        here = matrix[:, :count]
        weights = active.solve(here.T @ here, here.T @ signal)
        assert np.isfinite(weights).all()
        gradient = here.T @ (signal - here @ weights)
        # the conditions of Karush, Kuhn and Tucker, which are enough
        slack = 1e-8 * np.abs(here.T @ signal).max()
        if nonnegative:
            assert (weights >= 0).all()
            assert (gradient <= penalty + slack).all()
        else:
            assert (np.abs(gradient) <= penalty + slack).all()
        used = weights != 0
        np.testing.assert_allclose(gradient[used], penalty * np.sign(weights[used]), atol=slack)


def test_nothing_is_used_under_a_heavy_penalty() -> None:
    matrix, signal = problem(6, seed=6)
    right = matrix.T @ signal
    for factor, used in ((1.001, 0), (0.999, 1)):
        active = ActiveSet(penalty=factor * float(np.abs(right).max()))
        for _ in range(6):
            active.grow()
        assert np.count_nonzero(active.solve(matrix.T @ matrix, right)) == used


@pytest.mark.parametrize("nonnegative", [False, True])
def test_no_atoms_and_no_signal(nonnegative: bool) -> None:
    active = ActiveSet(nonnegative=nonnegative)
    assert active.solve(np.zeros((0, 0)), np.zeros(0)).shape == (0,)
    active.grow()
    assert active.solve(np.eye(1), np.zeros(1)).tolist() == [0.0]


def test_the_signal_may_change_between_calls() -> None:
    """As between colours or refinements: warm or cold, the minimum is the minimum."""
    matrix, signal = problem(15, seed=7)
    gram = matrix.T @ matrix
    active = ActiveSet(penalty=3.0, nonnegative=True)
    for _ in range(15):
        active.grow()
    for target in (signal, -signal, signal[::-1].copy()):
        found = active.solve(gram, matrix.T @ target)
        np.testing.assert_allclose(found, lasso(matrix, target, 3.0, True), atol=1e-7, rtol=0)


def test_cholesky_factor_follows_its_members() -> None:
    """Against numpy's, after every step, beyond the first 16 atoms."""
    draw = np.random.default_rng(8)
    matrix = draw.standard_normal((60, 40))
    gram, factor = matrix.T @ matrix, CholeskyFactor()
    for step in range(120):
        absent = [a for a in range(40) if a not in factor.members]
        if absent and (len(factor.members) < 3 or draw.random() < 0.65):
            atom = int(draw.choice(absent))
            assert factor.append(atom, gram)
            assert factor.members[-1] == atom
        else:
            atom = int(draw.choice(factor.members))
            factor.remove(atom)
            assert atom not in factor.members
        members = factor.members
        block, n = gram[np.ix_(members, members)], len(members)
        lower = np.linalg.cholesky(block)
        np.testing.assert_allclose(factor._lower[:n, :n], lower, atol=1e-9, err_msg=str(step))
        right = draw.standard_normal(n)
        np.testing.assert_allclose(factor.solve(right), np.linalg.solve(block, right), atol=1e-9)
    assert len(factor._lower) > 16


def test_cholesky_factor_refuses_dependent_atoms() -> None:
    gram, factor = np.ones((2, 2)), CholeskyFactor()
    assert factor.append(1, gram)
    assert not factor.append(0, gram)
    assert factor.members == [1]
    assert not CholeskyFactor().append(0, np.zeros((1, 1)))


HEIGHT, DEGREE = 6, 4


@dataclass
class Case:
    """A quadratic, and A, W and x of the error that it stands for."""

    quadratic: Quadratic
    operator: torch.Tensor
    weights: torch.Tensor
    values: torch.Tensor


def case(kind: str) -> Case:
    grid = DirectionGrid.latlong(HEIGHT)
    basis = harmonics.evaluate_about_zenith(grid.directions, DEGREE)
    if kind == "matrix":
        operator, weights, values = random(40, 25), random(40, seed=1).abs(), random(40, 3, seed=2)
        return Case(LinearObservation.of(operator, values, weights), operator, weights, values)
    maps, pixels = random(HEIGHT, 2 * HEIGHT, 3), kind == "map and pixels"
    if pixels:
        basis = torch.cat([basis, torch.eye(len(basis), dtype=F64)], 1)
    signal = SampledSignal.of(maps, LatLongTransform(DEGREE, HEIGHT), pixels=pixels)
    return Case(signal, basis, grid.solid_angles, maps.reshape(-1, 3))


KINDS = ["matrix", "map", "map and pixels"]


@pytest.mark.parametrize("kind", KINDS)
def test_is_the_squared_error_of_each_colour(kind: str) -> None:
    """|x - A c|^2_W, in words."""
    it = case(kind)
    c = random(it.operator.shape[1], 3, seed=5)
    found = (
        it.quadratic.energy
        - 2 * (it.quadratic.target * c).sum(0)
        + (c * it.quadratic.hessian(c)).sum(0)
    )
    expected = it.weights @ (it.values - it.operator @ c).square()
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=0)


@pytest.mark.parametrize("kind", KINDS)
def test_hessian_and_target_are_what_the_operator_says(kind: str) -> None:
    it = case(kind)
    weighted = it.operator * it.weights[:, None]
    size = it.operator.shape[1]
    found = it.quadratic.hessian(torch.eye(size, dtype=F64))
    torch.testing.assert_close(found, it.operator.T @ weighted, rtol=0, atol=1e-12)
    torch.testing.assert_close(it.quadratic.target, weighted.T @ it.values, rtol=0, atol=1e-12)
    assert isinstance(it.quadratic, Quadratic)
    # one vector, and batches of any shape
    several = random(size, 2, 3, seed=6)
    images = it.quadratic.hessian(several)
    one = it.quadratic.hessian(several[:, 1, 2])
    torch.testing.assert_close(images[:, 1, 2], one, rtol=0, atol=1e-12)
