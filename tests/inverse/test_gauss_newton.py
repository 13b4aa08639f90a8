"""Gauss-Newton steps: known minima, starts that never get worse, batches like single starts."""

import pytest
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from skylight.inverse._gauss_newton import charbonnier, minimise_robust
from skylight.models._prior import convex_shape

pytestmark = pytest.mark.usefixtures("double")


def linear(seed=1, points=40, unknowns=5):
    generator = torch.Generator().manual_seed(seed)
    matrix = torch.randn(points, unknowns, generator=generator)
    return matrix, matrix @ torch.randn(unknowns, generator=generator)


def minimise_linear(matrix, right, x0, prior=None, **options):
    prior = prior or (lambda x, _: 0 * x.sum(1))
    return minimise_robust(
        lambda x, _: x @ matrix.T - right,
        lambda x, _: matrix.expand(len(x), -1, -1),
        torch.ones(1, len(matrix)),
        prior,
        x0,
        **{"iterations": 60, "tolerance": 1e-14} | options,
    )


def test_what_is_exact_is_found_in_spite_of_outliers():
    """A tenth of the equations wrong: the minimum of absolute deviations is the other's answer."""
    matrix, right = linear()
    answer = torch.linalg.lstsq(matrix, right[:, None]).solution[:, 0]
    right[::10] += 3
    found = minimise_linear(matrix, right, torch.zeros(1, 5))
    torch.testing.assert_close(found.x[0], answer, atol=2e-3, rtol=0)


def test_the_end_is_a_minimum_of_the_whole():
    matrix, right = linear()
    right = right + torch.linspace(-1, 1, len(right)) ** 3

    def prior(x, _):
        return 0.5 * (x - 0.3).square().sum(1) + (x[:, 0] ** 4)

    options = {"iterations": 500, "tolerance": 0.0}  # near kinks its steps are short
    found = minimise_linear(matrix, right, torch.ones(1, 5), prior, **options).x.requires_grad_()
    loss = charbonnier(found @ matrix.T - right).sum() + prior(found, None).sum()
    (slope,) = torch.autograd.grad(loss, found)
    assert float(slope.abs().max()) < 1e-3


def curved(x, _=None):
    """Rosenbrock's residuals."""
    return torch.stack([10 * (x[:, 1] - x[:, 0] ** 2), 1 - x[:, 0]], 1)


def curved_jacobian(x, _):
    zero = torch.zeros_like(x[:, 0])
    rows = [[-20 * x[:, 0], zero + 10], [zero - 1, zero]]
    return torch.stack([torch.stack(row, 1) for row in rows], 1)


@pytest.mark.parametrize("broyden", [False, True])
def test_a_batch_is_as_its_starts_alone_and_never_worse(broyden):
    starts = torch.tensor([[-1.2, 1.0], [0.0, 0.0], [3.0, -4.0]])
    options = {"iterations": 25, "tolerance": 1e-12, "broyden": broyden}
    weights, prior = torch.ones(1, 2), lambda x, _: 0 * x.sum(1)
    every = minimise_robust(curved, curved_jacobian, weights, prior, starts, **options)
    for k, start in enumerate(starts):
        alone = minimise_robust(curved, curved_jacobian, weights, prior, start[None], **options)
        torch.testing.assert_close(every.x[k], alone.x[0])
        assert float(every.loss[k]) < float(charbonnier(curved(start[None])).sum())
    few = minimise_robust(curved, curved_jacobian, weights, prior, starts, iterations=2)
    assert bool((few.loss <= charbonnier(curved(starts)).sum(1)).all())
    assert not bool(few.converged.all())


def test_broydens_updates_find_the_same_minimum_with_fewer_jacobians():
    """Logistic curves through points, from where they are near: the Jacobian changes little."""
    times = torch.linspace(-3, 3, 25)
    truth = torch.tensor([1.3, 0.4, 2.0])

    def curve(x):
        return x[:, 2:] * torch.sigmoid(x[:, :1] * (times - x[:, 1:2]))

    seen = curve(truth[None]) + 0.05 * torch.sin(40 * times)
    ends, counts = [], []
    for broyden in (False, True):
        counts.append(0)

        def jacobian(x, _):
            counts[-1] += 1
            rate, middle, height = x[:, :, None].unbind(1)
            logistic = torch.sigmoid(rate * (times - middle))
            slope = height * logistic * (1 - logistic)
            return torch.stack([slope * (times - middle), -slope * rate, logistic], 2)

        ends.append(
            minimise_robust(
                lambda x, _: curve(x) - seen,
                jacobian,
                torch.ones(1, len(times)),
                lambda x, _: 0 * x.sum(1),
                truth[None] + torch.tensor([[0.3, -0.3, 0.4]]),
                iterations=200,
                tolerance=1e-12,
                broyden=broyden,
            )
        )
    assert counts[1] < 0.5 * counts[0]
    torch.testing.assert_close(ends[1].x, ends[0].x, atol=1e-3, rtol=0)


def test_starts_have_weights_and_priors_of_their_own():
    matrix, right = linear(unknowns=1)
    weights = torch.zeros(2, len(matrix))
    weights[0] = 1
    target = torch.tensor([0.0, 7.0])
    found = minimise_robust(
        lambda x, _: x @ matrix.T - right,
        lambda x, _: matrix.expand(len(x), -1, -1),
        weights,
        lambda x, rows: 1e-6 * (x[:, 0] - target[rows]).square(),
        torch.ones(2, 1),
        iterations=50,
        tolerance=1e-14,
    )
    expected = torch.linalg.lstsq(matrix, right[:, None]).solution[0, 0]
    torch.testing.assert_close(found.x[:, 0], torch.stack([expected, target[1]]), atol=1e-3, rtol=0)


def test_a_start_that_is_not_finite_harms_no_other():
    matrix, right = linear()
    starts = torch.zeros(3, 5)
    starts[1] = torch.nan
    found = minimise_linear(matrix, right, starts)
    alone = minimise_linear(matrix, right, starts[:1])
    assert float(found.loss[1]) == torch.inf
    torch.testing.assert_close(found.x[[0, 2]], alone.x.expand(2, -1))
    assert int(found.loss.argmin()) != 1


def test_the_priors_hessian_has_no_negative_curvature():
    """x^2 - y^2: the curvature of y counts as 0, the slope is whole."""
    at = torch.tensor([[0.5, 2.0]])
    slope, hessian = convex_shape(lambda x, _: x[:, 0] ** 2 - x[:, 1] ** 2, at, torch.tensor([0]))
    torch.testing.assert_close(slope, torch.tensor([[1.0, -4.0]]))
    torch.testing.assert_close(
        hessian, torch.diag(torch.tensor([2.0, 0.0]))[None], atol=1e-6, rtol=0
    )


class _Copied(TorchFunctionMode):
    """Counts copies to the host, which dispatch nothing on a CPU."""

    count = 0

    def __torch_function__(self, func, types, args=(), kwargs=None):
        self.count += func in (Tensor.cpu, Tensor.tolist, Tensor.numpy)
        return func(*args, **(kwargs or {}))


class _Asked(TorchDispatchMode):
    """Counts values that are read one by one, and sizes that depend on values."""

    count = 0

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name = func.overloadpacket.__name__
        masks = name in ("index", "index_put", "index_put_") and any(
            one is not None and one.dtype == torch.bool for one in args[1]
        )
        reads = ("_local_scalar_dense", "is_nonzero", "equal", "nonzero", "masked_select")
        self.count += masks or name in reads or "unique" in name
        return func(*args, **(kwargs or {}))


@pytest.mark.parametrize(
    "wait",
    [
        Tensor.cpu,
        Tensor.tolist,
        Tensor.numpy,
        Tensor.nonzero,
        Tensor.unique,
        Tensor.unique_consecutive,
        lambda x: x.unique(dim=0),
        lambda x: x[1].item(),
        lambda x: bool(x.any()),
        lambda x: x.equal(x + 1),
        lambda x: x[x > 1],
        lambda x: x.masked_select(x > 1),
    ],
)
def test_all_that_the_host_waits_for_is_counted(wait):
    x = torch.arange(3.0)
    with _Copied() as copied, _Asked() as asked:
        (x + x).cumsum(0)
        assert copied.count + asked.count == 0
        wait(x)
    assert copied.count + asked.count == 1


@pytest.mark.parametrize("broyden", [False, True])
def test_a_further_iteration_waits_for_one_answer(broyden):
    """Which starts go on, and where derivatives are wanted: one copy, of which are three lists."""
    starts = torch.tensor([[-1.2, 1.0], [0.0, 0.0], [3.0, -4.0]])
    counts = []
    for iterations in (2, 7):
        with _Copied() as copied, _Asked() as asked:
            found = minimise_robust(
                curved,
                curved_jacobian,
                torch.ones(1, 2),
                lambda x, _: 0 * x.sum(1),
                starts,
                iterations=iterations,
                tolerance=0.0,
                broyden=broyden,
                shape=lambda x, _: (0 * x, torch.zeros(*x.shape, x.shape[1])),
            )
        assert found.iterations.tolist() == 3 * [iterations]
        counts.append(torch.tensor([copied.count, asked.count]))
    assert (counts[1] - counts[0]).tolist() == [5, 3 * 5]
