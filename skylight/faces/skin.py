"""A prior of skin albedo.

A picture fixes only the product of albedo and light. This prior says which albedos skin has, from
measured reflectance spectra (``tools/build_skin_prior.py`` tells how), and so which share of that
product is light.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import AssetError
from skylight.models.prior import GaussianMixture


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

    def log_prob(self, albedo: Float[Tensor, "b 3"]) -> Float[Tensor, " b"]:
        """ln p(a) = ln p_log(ln a) - sum_c ln a_c, normalised over all positive albedos.

        The sum is the change of variables from log-albedo. It makes dark skin, whose albedos crowd
        together, likelier by several nats; ``log_albedo.log_prob`` at ln a is about level over
        tone. Below 1e-6, where p is practically 0, the value is that at 1e-6 and the gradient 0.
        """
        log_albedo = albedo.clamp(min=1e-6).log()
        return self.log_albedo.log_prob(log_albedo) - log_albedo.sum(dim=1)

    def sample(self, count: int, generator: torch.Generator) -> Float[Tensor, "n 3"]:
        """``count`` independent albedos; ``generator`` lives where the mixture does (the CPU)."""
        return self.log_albedo.sample(count, generator).exp()
