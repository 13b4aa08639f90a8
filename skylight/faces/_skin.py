"""The albedo of skin: a prior over people, and how melanin and blood vary over one face.

A picture fixes only the product of albedo and light. The prior says which albedos skin has, from
measured reflectance spectra (``tools/build_skin_prior.py`` tells how), and so which share of that
product is light.

One albedo does not make a face: cheeks, nose and chin are redder, foreheads and jaws differ. The
log of the amount of either pigment is a Gaussian process over the mean
head, so that a skin point p of a person with albedo a has ::

    log rho_p = log a - sum_i s_i d_i sum_k Phi_pk z_ik,    z_ik ~ N(0, 1),

with d_i the colour of pigment i and Phi the leading Karhunen-Loeve modes of the kernel ::

    k(x, y) ~ k_0(x, y) + c k_0(x, mirrored y),    k_0 = exp(-|x - y|^2 / (2 l^2)),

of variance 1 before the mean over the face is taken off, which belongs to a. Two sides of a face
are much alike, hence c: a face that is darker on one side is likelier lit from the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from skylight.errors import AssetError
from skylight.faces._model import HeadModel, Region
from skylight.models._prior import GaussianMixture

# What an e-th more of either absorbs, in the log of linear Rec.709 with green at 1, at the middle
# tone (melanosomes 5 % of the epidermis, blood 1.7 % of the dermis) of the skin that
# tools/build_skin_spectra.py computes from Jacques' absorption of skin (1998, 2013).
MELANIN_COLOUR = (0.77, 1.0, 1.37)
BLOOD_COLOUR = (0.38, 1.0, 0.79)
PIGMENT_COLOURS = (MELANIN_COLOUR, BLOOD_COLOUR)
# Standard deviations s over a face, in log green. Choices, not measured: 3 units of L* and of a*
# (at L* 60 three units of L* are 12 % of luminance; blood that adds 3 to a* takes 8 % off green).
PIGMENT_SPREADS = (0.10, 0.08)
CORRELATION_M = 0.035  # l: cheeks, nose, forehead, chin are fields of such a size. A choice.
SYMMETRY = 0.8  # c, a choice
MODES = 10
_CELL_M = 0.015  # of the quadrature over the face: well below l
# where pixels of an observation can be: the modes of other vertices are 0
_SKIN = (Region.FACE, Region.BROW, Region.LIPS, Region.EAR, Region.NECK, Region.SCALP)


@dataclass(frozen=True, kw_only=True)
class SkinPrior:
    """Density over skin albedo a, linear Rec.709: a Gaussian mixture over log a.

    After Weyrich et al. 2006, whose albedos are not public. An albedo here is what a spectral
    reflectance becomes under D65, less most of the 2.8 % that the surface reflects: shading has a
    term of its own for that.
    """

    log_albedo: GaussianMixture

    @staticmethod
    @cache
    def load() -> SkinPrior:
        """The prior shipped with the package, float64; read once.

        Raises
        ------
        AssetError
            The file is missing or damaged.
        """
        with as_file(files("skylight.faces") / "data" / "skin_prior.safetensors") as path:
            mixture = GaussianMixture.load(path)
            if mixture.means.shape[1] != 3:
                raise AssetError(f"{path} is no prior over albedos: install skylight again")
        return SkinPrior(log_albedo=mixture)

    @property
    def means(self) -> Float[Tensor, "k 3"]:
        """One albedo per component within (0, 1), heaviest component first: where to start."""
        return self.log_albedo.means.exp().clamp(1e-3, 1 - 1e-3)

    @property
    def mean(self) -> Float[Tensor, " c"]:
        """The mean albedo, sum_k w_k exp(mu_k + diag(S_k) / 2) with S_k the covariances."""
        mixture = self.log_albedo
        variances = mixture.covariances.diagonal(dim1=1, dim2=2)
        return mixture.weights @ (mixture.means + variances / 2).exp()

    def log_prob(self, albedo: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
        """ln p(a) = ln p_log(ln a) - sum_c ln a_c, normalised over all positive albedos.

        The sum is the change of variables from log-albedo. It makes dark skin, whose albedos crowd
        together, likelier by several nats; ``log_albedo.log_prob`` at ln a is about level over
        tone. Below 1e-6, where p is practically 0, the value is that at 1e-6 and the gradient 0.
        """
        log_albedo = albedo.clamp(min=1e-6).log()
        return self.log_albedo.log_prob(log_albedo) - log_albedo.sum(dim=-1)

    def sample(
        self, shape: int | Sequence[int] = (), generator: torch.Generator | None = None
    ) -> Float[Tensor, "*shape 3"]:
        """Independent albedos; ``generator`` lives where the mixture does (the CPU)."""
        return self.log_albedo.sample(shape, generator).exp()


@cache
def pigment_modes() -> Float[ndarray, "n k"]:
    """Phi at the head's vertices: sqrt(eigenvalue) times orthonormal modes on its mean face.

    Modes solve ``integral k(x, y) f(y) dy = lambda f(x)`` over the face's area (of measure 1), by
    Nystrom's method: quadrature over cells of 15 mm, then the integral itself elsewhere.
    """
    model = HeadModel.load()
    nodes, weights = face_quadrature(model)
    skin = np.flatnonzero(np.isin(model.regions, _SKIN))
    root = np.sqrt(weights)
    values, vectors = np.linalg.eigh(root[:, None] * _centred_kernel(nodes, nodes, weights) * root)
    leading = slice(None, -MODES - 1, -1)
    values, vectors = values[leading], vectors[:, leading]
    # the sign of an eigenvector is free: each mode's largest node is positive
    vectors = vectors * np.sign(vectors[np.abs(vectors).argmax(0), np.arange(MODES)])
    modes = np.zeros((len(model.mean), MODES))
    outer = _centred_kernel(model.mean[skin], nodes, weights)
    modes[skin] = outer @ (root[:, None] * vectors) / np.sqrt(values)
    modes.flags.writeable = False  # shared by every caller
    return modes


def face_quadrature(model: HeadModel) -> tuple[Float[ndarray, "q 3"], Float[ndarray, " q"]]:
    """(nodes, weights): the area of the mean face by cells; the weights sum to 1."""
    corners = model.faces[(model.regions == Region.FACE)[model.faces].all(1)]
    a, b, c = (model.mean[corners[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    centre = (a + b + c) / 3
    # cells are symmetric about the middle, x = 0
    cell = np.floor(centre / _CELL_M).astype(int)
    _, index = np.unique(cell, axis=0, return_inverse=True)
    weights = np.bincount(index.ravel(), area)
    nodes = np.stack([np.bincount(index.ravel(), area * x) for x in centre.T], 1) / weights[:, None]
    return nodes, weights / weights.sum()


def _centred_kernel(
    points: Float[ndarray, "m 3"], nodes: Float[ndarray, "q 3"], weights: Float[ndarray, " q"]
) -> Float[ndarray, "m q"]:
    """k of the process less its mean over the face, between points and the quadrature's nodes."""
    pairs, within = _kernel(points, nodes), _kernel(nodes, nodes) @ weights
    return pairs - (pairs @ weights)[:, None] - within + weights @ within


def _kernel(points: Float[ndarray, "m 3"], others: Float[ndarray, "n 3"]) -> Float[ndarray, "m n"]:
    variances = (1 + SYMMETRY * _near(x, _mirrored(x)) for x in (points, others))
    left, right = variances
    mixed = _pairs(points, others) + SYMMETRY * _pairs(points, _mirrored(others))
    return mixed / np.sqrt(left[:, None] * right)


def _mirrored(points: Float[ndarray, "m 3"]) -> Float[ndarray, "m 3"]:
    return points * np.array([-1.0, 1.0, 1.0])


def _near(points: Float[ndarray, "m 3"], others: Float[ndarray, "m 3"]) -> Float[ndarray, " m"]:
    """k_0 of each point and the other at its place."""
    return np.exp(-((points - others) ** 2).sum(1) / (2 * CORRELATION_M**2))


def _pairs(points: Float[ndarray, "m 3"], others: Float[ndarray, "n 3"]) -> Float[ndarray, "m n"]:
    squared = (points**2).sum(1)[:, None] + (others**2).sum(1) - 2 * points @ others.T
    return np.exp(squared.clip(min=0) / (-2 * CORRELATION_M**2))
