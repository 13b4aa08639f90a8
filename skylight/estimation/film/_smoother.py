"""Unknowns that drift, seen now and then: Kalman's filter, its smoother, and the evidence.

::

    x_1 ~ N(m, P),   x_{k+1} = x_k + N(0, (t_{k+1} - t_k) diag(q)),   z_k = C_k x_k + N(0, s I).

Rauch, Tung & Striebel (1965), "Maximum likelihood estimates of linear dynamic systems", AIAA
Journal 3(8). What is not to drift has q = 0. How fast the rest does, and how much larger than they
say themselves the errors of the sights are, maximise the evidence p(z_1, ..., z_K).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

_RANK = 1e-9  # of the largest eigenvalue: what is told less is not told
# Per second, of the variance that is likely a priori: from a light that stands still for all that a
# film can tell to one that is another after a quarter of an hour. Without the upper bound, errors
# that come and go with the head's pose pass for a light that drifts.
DRIFTS = 1e-9, 1e-3
NOISES = 0.1, 1e3
_COARSE = 5, 4


@dataclass(frozen=True, kw_only=True)
class Sight:
    """``value`` (m,) is ``matrix`` (m,n) times the unknowns, and unit noise."""

    matrix: Float[ndarray, "m n"]
    value: Float[ndarray, " m"]

    @staticmethod
    def of_minimum(
        at: Float[ndarray, " n"], slope: Float[ndarray, " n"], hessian: Float[ndarray, "n n"]
    ) -> "Sight":
        """The sight whose ``|z - C x|^2 / 2`` has that slope and Hessian at ``at``.

        Laplace's approximation of a likelihood. Directions in which the Hessian is next to 0, in
        which nothing is told, are left out.
        """
        values, vectors = np.linalg.eigh(0.5 * (hessian + hessian.T))
        told = values > _RANK * max(values[-1], 1e-300)
        root = np.sqrt(values[told])
        matrix = root[:, None] * vectors[:, told].T
        return Sight(matrix=matrix, value=matrix @ at - (vectors[:, told].T @ slope) / root)


@dataclass(frozen=True, kw_only=True)
class Drifting:
    """The prior of the first unknowns, the times of the sights, and which unknowns drift.

    ``scale`` (n,) is each unknown's variance of a drift of 1 per second; 0 of what stands still.
    """

    mean: Float[ndarray, " n"]
    covariance: Float[ndarray, "n n"]
    times_s: Float[ndarray, " k"]
    scale: Float[ndarray, " n"]


def covariance_of(precision: Float[ndarray, "n n"]) -> Float[ndarray, "n n"]:
    """The inverse of what is symmetric but for the rounding of float32, made symmetric.

    Inverted as it is, a difference of 1e-6 grows by the square of what is hardly known, 1e3, and
    covariances of sights are no longer positive.
    """
    inverse = np.linalg.inv(0.5 * (precision + precision.T))
    return 0.5 * (inverse + inverse.T)


@dataclass(frozen=True, kw_only=True)
class Smoothed:
    """Means and covariances of the unknowns at each sight, given all sights."""

    means: Float[ndarray, "k n"]
    covariances: Float[ndarray, "k n n"]
    log_evidence: float


def smooth(
    model: Drifting, sights: Sequence[Sight], *, drift: float, noise: float = 1.0
) -> Smoothed:
    """p(x_k | z_1, ..., z_K) for a ``drift`` per second and a variance of ``noise``."""
    filtered, predicted, evidence = _filtered(model, sights, drift, noise)
    mean, covariance = filtered[-1]
    means, covariances = [mean], [covariance]
    for (here, around), (ahead, spread) in zip(
        reversed(filtered[:-1]), reversed(predicted[1:]), strict=True
    ):
        gain = cho_solve(cho_factor(spread), around).T
        mean = here + gain @ (mean - ahead)
        covariance = around + gain @ (covariance - spread) @ gain.T
        means.append(mean)
        covariances.append(0.5 * (covariance + covariance.T))
    return Smoothed(
        means=np.array(means[::-1]),
        covariances=np.array(covariances[::-1]),
        log_evidence=evidence,
    )


def likeliest(model: Drifting, sights: Sequence[Sight]) -> tuple[float, float]:
    """(drift, noise) of the greatest evidence, within :data:`DRIFTS` and :data:`NOISES`."""
    (slowest, fastest), (least, most) = bounds = np.log([DRIFTS, NOISES])

    def cost(logs: Float[ndarray, "2"]) -> float:
        drift, noise = np.exp(logs)
        return -_filtered(model, sights, float(drift), float(noise))[2]

    tried = [
        np.array([a, b])
        for a in np.linspace(slowest, fastest, _COARSE[0])
        for b in np.linspace(least, most, _COARSE[1])
    ]
    best = min(tried, key=cost)
    found = minimize(
        cost,
        best,
        method="Nelder-Mead",
        bounds=bounds.tolist(),
        options={"xatol": 0.05, "fatol": 0.05},
    )
    drift, noise = np.exp(found.x)
    return float(drift), float(noise)


_Normal = tuple[Float[ndarray, " n"], Float[ndarray, "n n"]]


def _filtered(
    model: Drifting, sights: Sequence[Sight], drift: float, noise: float
) -> tuple[list[_Normal], list[_Normal], float]:
    """(after each sight, before it, log evidence)."""
    mean, covariance = model.mean, model.covariance
    filtered, predicted, evidence = [], [], 0.0
    steps = np.diff(model.times_s, prepend=model.times_s[0])
    for sight, step_s in zip(sights, steps, strict=True):
        covariance = covariance + np.diag(model.scale * (drift * step_s))
        predicted.append((mean, covariance))
        cross = covariance @ sight.matrix.T
        spread = sight.matrix @ cross
        spread[np.diag_indices_from(spread)] += noise
        factor = cho_factor(spread, lower=True)
        gap = sight.value - sight.matrix @ mean
        explained = cho_solve(factor, gap)
        evidence -= 0.5 * (gap @ explained + len(gap) * math.log(2 * math.pi))
        evidence -= float(np.log(np.diag(factor[0])).sum())
        mean = mean + cross @ explained
        covariance = covariance - cross @ cho_solve(factor, cross.T)
        covariance = 0.5 * (covariance + covariance.T)
        filtered.append((mean, covariance))
    return filtered, predicted, evidence
