import copy
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal
from sklearn.mixture import GaussianMixture as SklearnMixture
from torch import nn

from skylight.errors import AssetError, InputError, OutputError
from skylight.io._tensors import write_tensors
from skylight.models._base import Prior
from skylight.models._lamps import LampsPrior
from skylight.models._prior import GaussianMixture

F64 = torch.float64


def covariances(count: int, size: int) -> np.ndarray:
    root = np.random.default_rng(1).normal(size=(count, size, size))
    return root @ root.transpose(0, 2, 1) + 0.3 * np.eye(size)


def mixture(size: int) -> tuple[GaussianMixture, np.ndarray, np.ndarray, np.ndarray]:
    weights = np.array([0.5, 0.3, 0.2])
    means = np.random.default_rng(0).normal(size=(3, size)) * 2
    covariance = covariances(3, size)
    # upper triangular B with B B^T = inverse covariance
    factors = np.stack([np.triu(np.linalg.inv(np.linalg.cholesky(c)).T) for c in covariance])
    model = GaussianMixture(*(torch.tensor(a) for a in (weights, means, factors)))
    return model, weights, means, covariance


@pytest.mark.parametrize("size", [1, 2, 7])
def test_density_is_scipys(size: int) -> None:
    model, weights, means, covariance = mixture(size)
    x = np.random.default_rng(2).normal(size=(50, size)) * 3
    density = sum(
        w * multivariate_normal(m, c).pdf(x)
        for w, m, c in zip(weights, means, covariance, strict=True)
    )
    np.testing.assert_allclose(model.log_prob(torch.tensor(x)).numpy(), np.log(density), rtol=1e-10)


def test_gradient_is_right_and_far_away_finite() -> None:
    model = mixture(3)[0]
    x = torch.randn(4, 3, generator=torch.Generator().manual_seed(0), dtype=F64)
    assert torch.autograd.gradcheck(model.log_prob, x.requires_grad_())
    far = torch.full((1, 3), 1e4, requires_grad=True)
    model.log_prob(far).sum().backward()
    assert far.grad is not None
    assert far.grad.isfinite().all()


def test_samples_have_the_moments() -> None:
    model, weights, means, covariance = mixture(2)
    x = model.sample(200_000, torch.Generator().manual_seed(0)).numpy()
    mean = weights @ means
    spread = np.einsum("k,kij->ij", weights, covariance) + np.einsum(
        "k,ki,kj->ij", weights, means - mean, means - mean
    )
    np.testing.assert_allclose(x.mean(0), mean, atol=5 * math.sqrt(spread.max() / 200_000))
    np.testing.assert_allclose(np.cov(x.T), spread, rtol=0.03, atol=0.05)


def test_same_generator_same_samples() -> None:
    model = mixture(2)[0]
    first, second = (model.sample(5, torch.Generator().manual_seed(7)) for _ in range(2))
    assert torch.equal(first, second)


def test_fit_is_where_sklearn_stays() -> None:
    """From our mixture, scikit-learn's EM gains next to nothing, and from its own start no more."""
    samples = mixture(3)[0].sample(600, torch.Generator().manual_seed(0))
    model = GaussianMixture.fit(samples, 3, seed=4, covariance_floor=1e-3)
    ours = model.log_prob(samples).mean().item()
    factors = model.precision_factors
    settings = {"reg_covar": 1e-3, "max_iter": 500, "tol": 1e-6}
    warm = SklearnMixture(
        3,
        weights_init=model.weights.numpy(),
        means_init=model.means.numpy(),
        precisions_init=(factors @ factors.mT).numpy(),
        **settings,
    )
    assert ours == pytest.approx(warm.fit(samples.numpy()).score(samples.numpy()), abs=0.01)
    cold = SklearnMixture(3, random_state=4, n_init=3, **settings)
    assert ours == pytest.approx(cold.fit(samples.numpy()).score(samples.numpy()), abs=0.01)
    assert (torch.diff(model.weights) <= 0).all()


def test_one_component_has_the_samples_moments() -> None:
    samples = mixture(3)[0].sample(50, torch.Generator().manual_seed(0))
    model = GaussianMixture.fit(samples, 1, covariance_floor=0.25)
    factor = model.precision_factors[0]
    expected = torch.cov(samples.T, correction=0) + 0.25 * torch.eye(3)
    torch.testing.assert_close(torch.linalg.inv(factor @ factor.T), expected)
    torch.testing.assert_close(model.means[0], samples.mean(0))
    assert model.weights.tolist() == [1]


def test_fit_finds_separate_clusters() -> None:
    noise = torch.randn(400, 2, generator=torch.Generator().manual_seed(0)) * 0.1
    samples = noise + torch.tensor([[0.0, 0.0]] * 100 + [[5.0, 1.0]] * 300)
    model = GaussianMixture.fit(samples, 2)
    torch.testing.assert_close(
        model.means, torch.tensor([[5.0, 1.0], [0.0, 0.0]], dtype=F64), atol=0.05, rtol=0
    )
    assert model.weights.tolist() == pytest.approx([0.75, 0.25])


def test_covariance_floor_holds_for_repeated_samples() -> None:
    model = GaussianMixture.fit(torch.ones(10, 2), 1, covariance_floor=0.04)
    peak = model.log_prob(torch.ones(1, 2, dtype=F64)).item()
    assert peak == pytest.approx(-math.log(2 * math.pi * 0.04))


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(InputError, match="5 components"):
        GaussianMixture.fit(torch.zeros(3, 2), 5)


def test_round_trip_through_a_file(tmp_path: Path) -> None:
    model = mixture(4)[0]
    path = tmp_path / "prior.safetensors"
    model.save(path)
    loaded = GaussianMixture.load(path)
    for name, tensor in model.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], tensor)
    assert [p.name for p in tmp_path.iterdir()] == ["prior.safetensors"]


@pytest.mark.parametrize("damage", ["missing", "empty", "noise", "truncated", "other", "shape"])
def test_damaged_files_are_asset_errors(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "prior.safetensors"
    model = mixture(2)[0]
    model.save(path)
    whole = path.read_bytes()
    if damage == "missing":
        path.unlink()
    elif damage == "other":
        write_tensors(path, {"weights": torch.ones(1)})
    elif damage == "shape":
        write_tensors(path, {**model.state_dict(), "means": torch.zeros(3, dtype=F64)})
    else:
        path.write_bytes({"empty": b"", "noise": b"x" * 64, "truncated": whole[:-9]}[damage])
    with pytest.raises(AssetError, match="prior"):
        GaussianMixture.load(path)


def test_unwritable_place_is_an_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot write"):
        mixture(1)[0].save(tmp_path / "nowhere" / "prior.safetensors")


def test_what_is_no_mixture_is_refused() -> None:
    eye = torch.eye(2)[None]
    with pytest.raises(ValueError, match="sum to 1"):
        GaussianMixture(torch.tensor([0.5]), torch.zeros(1, 2), eye)
    with pytest.raises(ValueError, match="triangular"):
        GaussianMixture(torch.ones(1), torch.zeros(1, 2), torch.ones(1, 2, 2))
    with pytest.raises(ValueError, match="finite"):
        GaussianMixture(torch.ones(1), torch.full((1, 2), math.nan), eye)


def test_a_widened_mixture_is_the_density_of_noisy_samples() -> None:
    generator = torch.Generator().manual_seed(4)
    factors = torch.randn(2, 3, 3, generator=generator, dtype=torch.float64).triu() * 0.3
    factors += 2 * torch.eye(3)
    mixture = GaussianMixture(
        torch.tensor([0.3, 0.7]).double(),
        torch.randn(2, 3, generator=generator, dtype=torch.float64),
        factors,
    )
    grey = torch.eye(3).double() - 1 / 3  # semi-definite
    x = torch.randn(20, 3, generator=generator, dtype=torch.float64)
    expected = sum(
        weight
        * torch.distributions.MultivariateNormal(
            mean, torch.linalg.inv(factor @ factor.T) + 0.5 * grey
        )
        .log_prob(x)
        .exp()
        for weight, mean, factor in zip(
            mixture.weights, mixture.means, mixture.precision_factors, strict=True
        )
    )
    torch.testing.assert_close(mixture.widened(0.5 * grey).log_prob(x), expected.log())
    torch.testing.assert_close(mixture.widened(0 * grey).log_prob(x), mixture.log_prob(x))


def priors() -> list[tuple[Prior, int]]:
    return [(mixture(7)[0].float(), 7), (LampsPrior(2), 30), (LampsPrior(0), 16)]


@pytest.mark.parametrize(("prior", "size"), priors())
def test_any_leading_dimensions_are_a_loop(prior: Prior, size: int) -> None:
    generator = torch.Generator().manual_seed(3)
    for shape in [(), (1,), (0,), (2, 3), (2, 0, 3), (2, 1, 2, 3)]:
        x = prior.sample(shape, generator)
        assert x.shape == (*shape, size)
        density = prior.log_prob(x)
        assert density.shape == shape
        each = [prior.log_prob(one) for one in x.reshape(-1, size)]
        torch.testing.assert_close(density.flatten(), torch.tensor(each))
    assert prior.sample().shape == (size,)
    same = [prior.sample(shape, torch.Generator().manual_seed(1)) for shape in (6, (6,), (2, 3))]
    assert torch.equal(same[0], same[1])
    assert torch.equal(same[0], same[2].flatten(0, 1))


@pytest.mark.parametrize(("prior", "size"), priors())
@pytest.mark.parametrize("to", [F64, torch.device("meta")])
def test_samples_are_where_the_prior_is(
    prior: nn.Module, size: int, to: torch.dtype | torch.device
) -> None:
    moved = copy.deepcopy(prior).to(to)
    assert isinstance(moved, Prior)
    x = moved.sample((2, 3))
    assert to in (x.dtype, x.device)
    assert moved.log_prob(x).shape == (2, 3)


@pytest.mark.slow
def test_many_samples_take_no_more_than_a_few_times_their_memory() -> None:
    """A factor for each draw, or all components of all rows, would be 1.6 GB."""
    script = """
import torch
from skylight.models import load_bundle
from tests.peak_memory import peak_mb
prior = load_bundle().prior()
before = peak_mb()
with torch.inference_mode():
    prior.log_prob(prior.sample(100_000))
print(peak_mb() - before)
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert float(done.stdout) < 8 * 100_000 * 64 * 4 / 2**20
