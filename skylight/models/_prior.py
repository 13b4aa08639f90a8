"""Priors over parameters: Gaussian mixtures with full covariances."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from skylight._modes import full_precision, single
from skylight._module import Module
from skylight.errors import AssetError, InputError, check_shape
from skylight.io._tensors import read_tensors, write_tensors
from skylight.models._base import draws

_STARTS, _KMEANS_ITERATIONS = 3, 50
_ROWS_AT_ONCE = 2**14  # each takes k p numbers
_SLOPE_STEP = 1e-3  # of differences of slopes
_ITERATIONS, _LEAST_GAIN = 500, 1e-5  # of expectation-maximisation


class GaussianMixture(Module):
    """``p(x) = sum_k w_k N(x; mu_k, (B_k B_k^T)^-1)``, normalised over R^p.

    Parameters
    ----------
    weights : (k,), positive, sum 1
    means : (k, p)
    precision_factors : (k, p, p)
        upper-triangular B_k with a positive diagonal; ``B_k B_k^T`` is the inverse covariance.
    """

    weights: Tensor
    means: Tensor
    precision_factors: Tensor

    def __init__(
        self,
        weights: Float[Tensor, " k"],
        means: Float[Tensor, "k p"],
        precision_factors: Float[Tensor, "k p p"],
    ) -> None:
        super().__init__()
        diagonal = precision_factors.diagonal(dim1=1, dim2=2)
        tensors = (weights, means, precision_factors)
        if not all(bool(t.isfinite().all()) for t in tensors):
            raise ValueError("weights, means and precision_factors must be finite")
        if not (weights > 0).all() or abs(float(weights.sum()) - 1) > 1e-4:
            raise ValueError("weights must be positive and sum to 1")
        if not (diagonal > 0).all() or not torch.equal(precision_factors.triu(), precision_factors):
            raise ValueError("precision_factors must be upper triangular with positive diagonals")
        self.register_buffer("weights", weights)
        self.register_buffer("means", means)
        self.register_buffer("precision_factors", precision_factors)

    def log_prob(self, x: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch"]:
        """Natural logarithm of the density, differentiable in x and of its dtype."""
        check_shape("GaussianMixture's parameters", x.shape, self.means.shape[1])
        x = single(x)
        rows = x.reshape(-1, x.shape[-1])
        # a compiled graph has one size, and keeps nothing between its steps
        some = (rows,) if torch.compiler.is_compiling() else rows.split(_ROWS_AT_ONCE)
        with full_precision(x):
            parts = [torch.logsumexp(self._log_weighted(each), dim=1) for each in some]
        return torch.cat(parts).reshape(x.shape[:-1])

    def _log_weighted(self, x: Float[Tensor, "b p"]) -> Float[Tensor, "b k"]:
        """``log w_k + log N(x; mu_k, (B_k B_k^T)^-1)``."""
        return self.weights.to(x.dtype).log() + log_normals(x, self.means, self.precision_factors)

    @torch.no_grad()
    def shape(self, x: Float[Tensor, "b p"]) -> tuple[Float[Tensor, "b p"], Float[Tensor, "b p p"]]:
        """Slope and Hessian of ``-log_prob``, in closed form and in x's dtype.

        With components' shares r_k at x, precisions P_k and slopes g_k = P_k (x - mu_k) they are
        ``g = sum_k r_k g_k`` and ``sum_k r_k (P_k - g_k g_k^T) + g g^T``.
        """
        at, factors = x.double(), self.precision_factors.double()
        share, precisions = torch.softmax(self._log_weighted(at), 1), factors @ factors.mT
        pulls = torch.einsum("bkp,kpq->bkq", at[:, None] - self.means.double(), precisions)
        slope = torch.einsum("bk,bkp->bp", share, pulls)
        off = pulls - slope[:, None]  # whose products lose no digits far away
        hessian = torch.einsum("bk,kpq->bpq", share, precisions)
        hessian = hessian - torch.einsum("bk,bkp,bkq->bpq", share, off, off)
        return slope.to(x), hessian.to(x)

    def sample(
        self, shape: int | Sequence[int] = (), generator: torch.Generator | None = None
    ) -> Float[Tensor, "*shape p"]:
        """Independent draws ``(*shape, p)``, n of them for ``shape=n`` and one for none.

        In the mixture's dtype and on its device, where ``generator`` lives too.
        """
        means, shape = self.means, draws(shape)
        count = shape.numel()
        which = torch.multinomial(  # refuses to draw none
            self.weights, max(count, 1), replacement=True, generator=generator
        )[:count, None]
        noise = torch.randn(
            count, means.shape[1], generator=generator, dtype=means.dtype, device=means.device
        )
        x = noise
        for k, factor in enumerate(self.precision_factors):  # a factor for each draw is p times x
            # B^-T z has the covariance (B B^T)^-1
            offset = torch.linalg.solve_triangular(factor.mT, noise.mT, upper=False).mT
            x = torch.where(which == k, means[k] + offset, x)
        return x.reshape(*shape, means.shape[1])

    @property
    def covariances(self) -> Float[Tensor, "k p p"]:
        """Of the components: (B_k B_k^T)^-1."""
        with full_precision(self.means):
            return torch.linalg.inv(self.precision_factors @ self.precision_factors.mT)

    def widened(self, covariance: Float[Tensor, "p p"]) -> "GaussianMixture":
        """The density of x + e with e from N(0, ``covariance``), which may be semi-definite."""
        own = self.covariances
        factors = precision_factors_of(own + covariance.to(own))
        return GaussianMixture(self.weights, self.means, factors)

    @staticmethod
    def fit(
        samples: Float[Tensor, "n p"],
        components: int,
        *,
        seed: int = 0,
        covariance_floor: float = 1e-6,
    ) -> "GaussianMixture":
        """Maximum likelihood by expectation-maximisation, heaviest component first; float64.

        From three k-means clusterings, each until an iteration gains less than 1e-5 of mean
        log-likelihood; the likeliest end counts. ``covariance_floor`` is added to every variance,
        in squared units of the samples: it keeps components from collapsing on to repeated or
        degenerate samples.

        Raises
        ------
        InputError
            Fewer samples than components, or fewer than two.
        """
        if samples.shape[0] < max(components, 2) or components < 1:
            raise InputError(
                f"{components} components cannot be fitted to {samples.shape[0]} samples: "
                "give more samples or ask for fewer components"
            )
        x = samples.detach().cpu().double()
        from scipy.cluster import vq  # takes 0.4 s to import, and priors that ship are fitted

        rng = np.random.default_rng(seed)
        ends = []
        for _ in range(_STARTS):
            _, cluster = vq.kmeans2(
                x.numpy(), components, iter=_KMEANS_ITERATIONS, minit="++", rng=rng
            )
            share = nn.functional.one_hot(torch.from_numpy(cluster).long(), components).double()
            ends.append(_maximise_expectation(x, share, covariance_floor))
        fitted, _ = max(ends, key=lambda end: end[1])
        order = fitted.weights.argsort(descending=True)
        return GaussianMixture(
            fitted.weights[order], fitted.means[order], fitted.precision_factors[order]
        )

    def save(self, path: Path) -> None:
        """Write a safetensors file, whole or not at all."""
        write_tensors(path, self.state_dict(), {"kind": "GaussianMixture"})

    @staticmethod
    def of(tensors: Mapping[str, Tensor]) -> "GaussianMixture":
        """The mixture of a ``state_dict``; KeyError or ValueError where that is none."""
        weights, means, factors = (
            tensors[name] for name in ("weights", "means", "precision_factors")
        )
        k, p = means.shape
        if weights.shape != (k,) or factors.shape != (k, p, p):
            raise ValueError("the shapes of its tensors do not match")
        return GaussianMixture(weights, means, factors)

    @staticmethod
    def load(path: Path) -> "GaussianMixture":
        """Read what :meth:`save` wrote; :class:`AssetError` where that is not in the file."""
        try:
            return GaussianMixture.of(read_tensors(path)[0])
        except (OSError, KeyError, ValueError, RuntimeError, IndexError) as error:
            raise AssetError(
                f"{path} holds no usable Gaussian mixture ({error}): fit or fetch it again"
            ) from error


def log_normals(
    x: Float[Tensor, "*b p"], means: Float[Tensor, "k p"], factors: Float[Tensor, "k p p"]
) -> Float[Tensor, "*b k"]:
    """``log N(x; mu_k, (B_k B_k^T)^-1)`` of means and precision factors, in x's dtype."""
    factors = factors.to(x.dtype)
    white = torch.einsum("...kp,kpq->...kq", x[..., None, :] - means.to(x.dtype), factors)
    log_det = factors.diagonal(dim1=1, dim2=2).log().sum(1)
    constant = log_det - 0.5 * x.shape[-1] * math.log(2 * math.pi)
    return constant - 0.5 * white.square().sum(-1)


def convex_shape(
    function: Callable[[Tensor, Tensor], Tensor], x: Float[Tensor, "b p"], rows: Int[Tensor, " b"]
) -> tuple[Float[Tensor, "b p"], Float[Tensor, "b p p"]]:
    """Slope of a function of points and their rows, and its Hessian without negative eigenvalues.

    The Hessian is by differences of the slope.
    """
    count, size = x.shape

    def slope_of(points: Tensor, rows: Tensor) -> Tensor:
        with torch.enable_grad():
            leaf = points.detach().requires_grad_(True)
            (slope,) = torch.autograd.grad(function(leaf, rows).sum(), leaf)
        return slope

    steps = _SLOPE_STEP * torch.eye(size).to(x)
    steps = torch.cat([steps, -steps, torch.zeros_like(steps[:1])])
    around, many = (x[:, None] + steps).flatten(0, 1), rows.repeat_interleave(len(steps))
    slopes = slope_of(around, many).unflatten(0, (count, -1))
    ahead, behind, here = slopes.split([size, size, 1], 1)
    return here[:, 0], convex((ahead - behind) / (2 * _SLOPE_STEP))


def convex(hessian: Float[Tensor, "*b p p"]) -> Float[Tensor, "*b p p"]:
    """Without its negative eigenvalues, and symmetric; what is not finite is 0."""
    finite = hessian.nan_to_num(posinf=0.0, neginf=0.0)
    values, vectors = torch.linalg.eigh(0.5 * (finite + finite.mT))
    return vectors @ (values.clamp(min=0)[..., None] * vectors.mT)


def precision_factors_of(covariances: Float[Tensor, "*b p p"]) -> Float[Tensor, "*b p p"]:
    """The upper triangular B of ``(B B^T)^-1 = covariance``.

    Cholesky's lower factor of the reversed matrix, reversed.
    """
    precisions = torch.linalg.inv(covariances).flip(-2, -1)
    return torch.linalg.cholesky(precisions).flip(-2, -1).triu()


def _maximise_expectation(
    x: Float[Tensor, "n p"], share: Float[Tensor, "n k"], floor: float
) -> tuple[GaussianMixture, float]:
    """The mixture that EM ends in from these shares, and its mean log-likelihood."""
    before = -math.inf
    for _ in range(_ITERATIONS):
        mixture = _most_likely(x, share, floor)
        joint = mixture._log_weighted(x)
        total = torch.logsumexp(joint, dim=1)
        likelihood = float(total.mean())
        if likelihood - before < _LEAST_GAIN:
            break
        share, before = (joint - total[:, None]).exp(), likelihood
    return mixture, likelihood


def _most_likely(
    x: Float[Tensor, "n p"], share: Float[Tensor, "n k"], floor: float
) -> GaussianMixture:
    """The M step: weights, means and covariances of the samples, each shared out as ``share``."""
    mass = share.sum(0) + 10 * torch.finfo(share.dtype).eps  # a component may hold no sample
    means = share.T @ x / mass[:, None]
    offset = x - means[:, None]  # (k, n, p)
    covariance = (offset * share.T[..., None]).mT @ offset / mass[:, None, None]
    identity = torch.eye(x.shape[1], dtype=x.dtype)
    lower = torch.linalg.cholesky(covariance + floor * identity)
    factors = torch.linalg.solve_triangular(lower, identity, upper=False).mT
    return GaussianMixture(mass / mass.sum(), means, factors.triu())
