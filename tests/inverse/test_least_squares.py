"""Non-negative least squares: an active-set method of another's, singular and single problems.

A CPU pivots where unknowns are few, a GPU always: all is tested by pivots and one by one.
"""

import numpy as np
import pytest
import torch
from scipy.optimize import nnls as scipy_nnls

from skylight.inverse import _least_squares as least_squares
from skylight.inverse._least_squares import nnls


@pytest.fixture(autouse=True, params=[0, 99], ids=["one by one", "pivots"])
def few(request, monkeypatch):
    monkeypatch.setattr(least_squares, "_FEW", request.param)


def problems(seed, *, positive=True, count=30, equations=40, unknowns=9):
    rng = np.random.default_rng(seed)
    shape = count, equations, unknowns
    matrices = rng.random(shape) if positive else rng.normal(size=shape)
    wanted = rng.normal(size=shape[:2]) + positive
    gram = torch.from_numpy(np.einsum("bij,bik->bjk", matrices, matrices))
    right = torch.from_numpy(np.einsum("bij,bi->bj", matrices, wanted))
    answers = [scipy_nnls(a, y)[0] for a, y in zip(matrices, wanted, strict=True)]
    return gram, right, torch.from_numpy(np.stack(answers))


def objective(gram, right, x):
    return 0.5 * torch.einsum("bi,bij,bj->b", x, gram, x) - (right * x).sum(1)


@pytest.mark.parametrize("positive", [True, False], ids=["alike", "unlike"])
def test_as_solved_by_an_active_set_method(positive):
    gram, right, truth = problems(5, positive=positive)
    found = nnls(gram, right)
    assert (found >= 0).all()
    assert (truth == 0).any()  # the constraint matters
    torch.testing.assert_close(found, truth, atol=1e-7, rtol=0)


def test_the_start_does_not_matter_and_is_only_read():
    gram, right, truth = problems(7)
    for start in (truth, 1 - (truth > 0).double(), torch.ones_like(truth)):
        kept = start.clone()
        found = nnls(gram, right, start=start)
        torch.testing.assert_close(found, truth, atol=1e-7, rtol=0)
        assert torch.equal(start, kept)


def test_each_problem_is_solved_as_alone():
    gram, right, _ = problems(8, positive=False)
    found = nnls(gram, right)
    for k in range(len(gram)):
        alone = nnls(gram[k, None], right[k, None])
        torch.testing.assert_close(found[k, None], alone, atol=1e-12, rtol=0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_no_problems_have_no_answers(dtype):
    found = nnls(torch.zeros(0, 9, 9, dtype=dtype), torch.zeros(0, 9, dtype=dtype))
    assert found.shape == (0, 9)
    assert found.dtype == dtype


def test_more_unknowns_than_equations_are_explained_as_well():
    gram, right, truth = problems(9, equations=12, unknowns=30)
    best = objective(gram, right, truth)
    torch.testing.assert_close(
        objective(gram, right, nnls(gram, right)), best, atol=1e-6, rtol=1e-7
    )
    single = nnls(gram.float(), right.float())
    assert single.dtype == torch.float32
    torch.testing.assert_close(objective(gram, right, single.double()), best, atol=1e-4, rtol=1e-4)


def broad_lobes(width):
    """Columns on which pivoting goes round for very long, and what they are to explain."""
    at, centres = np.linspace(-1.5, 1.5, 200)[:, None], np.linspace(-1.5, 1.5, 22)
    lobes = np.exp(-0.5 * ((at - centres) / width) ** 2)
    wanted = np.random.default_rng(3).normal(size=(20, 200)) + 1
    return lobes / np.linalg.norm(lobes, axis=0), wanted


@pytest.mark.parametrize("width", [0.4, 0.8])
@pytest.mark.parametrize("pivots", [0, 200])
def test_columns_that_are_nearly_dependent(width, pivots, monkeypatch):
    monkeypatch.setattr(least_squares, "_PIVOTS", pivots)
    lobes, wanted = broad_lobes(width)
    gram = torch.from_numpy(lobes.T @ lobes).expand(20, -1, -1)
    right = torch.from_numpy(wanted @ lobes)
    best = torch.from_numpy(np.stack([scipy_nnls(lobes, y)[0] for y in wanted]))
    excess = objective(gram, right, nnls(gram, right)) - objective(gram, right, best)
    assert float(excess.abs().max()) < 1e-6 * float((wanted**2).sum(1).min())


@pytest.mark.parametrize("pivots", [0, 200])
def test_what_rounding_made_indefinite(pivots, monkeypatch):
    """In single precision, with errors as of a difference of such matrices."""
    monkeypatch.setattr(least_squares, "_PIVOTS", pivots)
    lobes, wanted = broad_lobes(0.8)
    gram = torch.from_numpy(lobes.T @ lobes).expand(20, -1, -1)
    right = torch.from_numpy(wanted @ lobes)
    noise = 2e-6 * torch.randn(gram.shape, generator=torch.Generator().manual_seed(0)).double()
    rounded = (gram + (noise + noise.transpose(1, 2)) / 2).float()
    assert (torch.linalg.eigvalsh(rounded.double())[:, 0] < -1e-6).all()  # more than is added
    best = torch.from_numpy(np.stack([scipy_nnls(lobes, y)[0] for y in wanted]))
    excess = objective(gram, right, nnls(rounded, right.float()).double())
    excess = excess - objective(gram, right, best)
    assert float(excess.abs().max()) < 1e-5 * float((wanted**2).sum(1).min())


def test_what_is_missing_is_nothing():
    """Unknowns whose row and right side are zero."""
    gram, right, truth = problems(10)
    for missing in (gram[:, 3], gram[:, :, 3], right[:, 3]):
        missing.zero_()
    found = nnls(gram, right, start=torch.ones_like(truth))
    assert bool((found[:, 3] == 0).all())
    rest = [k for k in range(9) if k != 3]
    alone = nnls(gram[:, rest][:, :, rest], right[:, rest])
    torch.testing.assert_close(found[:, rest], alone)


def test_spreads_are_those_of_draws_of_the_normal_density():
    generator = torch.Generator().manual_seed(3)
    root = torch.randn(4, 4, generator=generator, dtype=torch.float64)
    hessian = root @ root.T + torch.eye(4)
    slopes = torch.randn(2, 4, generator=generator, dtype=torch.float64)
    covariance = torch.linalg.inv(hessian)
    draws = torch.distributions.MultivariateNormal(torch.zeros(4).double(), covariance)
    torch.manual_seed(0)
    told = draws.sample((100_000,)) @ slopes.T
    (found,) = least_squares.spreads_at(hessian[None], slopes[None])
    torch.testing.assert_close(found, told.std(0), rtol=0.02, atol=0)
