"""The batched quasi-Newton method on problems whose minima are known."""

import pytest
import torch

from skylight.inverse._lbfgs import minimise

ROSENBROCK = torch.tensor([[1.0, 100.0], [0.5, 20.0], [-1.2, 50.0], [2.0, 5.0]]).double()
STARTS = torch.tensor([[-1.2, 1.0], [2.0, -1.0], [0.0, 0.0], [-3.0, 4.0]]).double()


def rosenbrock(x, index):
    """One minimum of 0, at (a, a^2)."""
    a, b = ROSENBROCK[index].unbind(1)
    return (a - x[:, 0]) ** 2 + b * (x[:, 1] - x[:, 0] ** 2) ** 2


def barrier(x, index):
    """sum c x - ln x: not a number for x < 0, minimum at 1 / c."""
    rate = torch.tensor([[1.0, 3.0], [0.2, 40.0], [7.0, 0.5]]).double()[index]
    return (rate * x - x.log()).sum(1)


def test_bent_valleys_are_followed_to_their_ends():
    found = minimise(rosenbrock, STARTS, iterations=200, tolerance=1e-12)
    a = ROSENBROCK[:, 0]
    torch.testing.assert_close(found.x, torch.stack([a, a**2], 1), atol=1e-6, rtol=0)
    assert found.converged.all()
    assert int(found.nonfinite.sum()) == 0


def test_ill_conditioned_quadratics_reach_the_solution_of_their_linear_systems():
    generator = torch.Generator().manual_seed(3)
    q, _ = torch.linalg.qr(torch.randn(5, 8, 8, generator=generator, dtype=torch.float64))
    spectrum = torch.logspace(0, 4, 8, dtype=torch.float64)
    hessian = q @ torch.diag(spectrum) @ q.mT
    right = torch.randn(5, 8, generator=generator, dtype=torch.float64)

    def quadratic(x, index):
        curved = torch.einsum("bi,bij,bj->b", x, hessian[index], x)
        return 0.5 * curved - (right[index] * x).sum(1)

    found = minimise(quadratic, torch.zeros_like(right), iterations=300, tolerance=1e-14)
    truth = torch.linalg.solve(hessian, right)
    torch.testing.assert_close(found.x, truth, atol=1e-5, rtol=1e-4)
    assert found.iterations.max() < 300
    torch.testing.assert_close(found.loss, -0.5 * (truth * right).sum(1), atol=1e-10, rtol=1e-8)


def test_problems_in_a_batch_do_not_feel_each_other():
    together = minimise(rosenbrock, STARTS, iterations=25)
    alone = [
        minimise(lambda x, _, i=i: rosenbrock(x, torch.full((len(x),), i)), s[None], iterations=25)
        for i, s in enumerate(STARTS)
    ]
    torch.testing.assert_close(together.x, torch.cat([m.x for m in alone]), atol=1e-9, rtol=0)
    assert together.iterations.tolist() == [int(m.iterations) for m in alone]
    assert together.converged.tolist() == [bool(m.converged) for m in alone]
    assert torch.equal(together.evaluations, torch.cat([m.evaluations for m in alone]))


def test_the_loss_never_rises_and_is_that_of_the_point_returned():
    losses = []
    for iterations in range(0, 40, 3):
        found = minimise(rosenbrock, STARTS, iterations=iterations, tolerance=0.0)
        torch.testing.assert_close(found.loss, rosenbrock(found.x, torch.arange(4)))
        losses.append(found.loss)
    assert (torch.stack(losses).diff(dim=0) <= 0).all()
    assert torch.equal(losses[0], rosenbrock(STARTS, torch.arange(4)))


def test_steps_into_what_is_not_a_number_are_taken_back():
    start = torch.full((3, 2), 0.4, dtype=torch.float64)
    found = minimise(barrier, start, iterations=100, tolerance=1e-13, first_step=5.0)
    assert int(found.nonfinite.sum()) > 0
    truth = torch.tensor([[1, 1 / 3], [5, 1 / 40], [1 / 7, 2]]).double()
    torch.testing.assert_close(found.x, truth, atol=1e-4, rtol=1e-4)
    # wherever it is stopped, what comes back is a point with a finite loss
    for iterations in range(6):
        stopped = minimise(barrier, start, iterations=iterations, first_step=5.0)
        assert stopped.x.isfinite().all()
        assert stopped.loss.isfinite().all()


def test_a_start_that_is_not_finite_is_reported_and_does_no_harm():
    start = torch.tensor([[0.5, 0.5], [-1.0, 0.5], [0.5, 0.5]]).double()
    found = minimise(barrier, start, iterations=100, tolerance=1e-13)
    assert found.converged.tolist() == [True, False, True]
    assert torch.equal(found.x[1], start[1])
    assert found.loss[1] == torch.inf
    assert found.iterations[1] == 0
    torch.testing.assert_close(found.x[2], torch.tensor([1 / 7, 2]).double(), atol=1e-4, rtol=1e-4)


def test_a_gradient_that_is_not_finite_counts_like_a_loss():
    # sqrt has a finite value and no slope at 0
    found = minimise(lambda x, _: x.abs().sqrt().sum(1), torch.zeros(1, 1), iterations=5)
    assert int(found.nonfinite.sum()) == 1
    assert not found.converged.any()


def test_a_start_at_the_minimum_stays():
    minimum = torch.tensor([[1.0, 1.0]]).double()
    found = minimise(rosenbrock, minimum, iterations=10)
    assert torch.equal(found.x, minimum)
    assert found.converged.all()
    assert int(found.nonfinite.sum()) == 0


@pytest.mark.parametrize("iterations", [1, 2])
def test_stopped_early_is_not_converged(iterations):
    found = minimise(rosenbrock, STARTS, iterations=iterations)
    assert not found.converged.any()
    assert (found.iterations == iterations).all()
