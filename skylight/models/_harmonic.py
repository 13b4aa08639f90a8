"""Spherical harmonics of low degree: a baseline without a prior of skies."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from skylight._modes import full_precision, single
from skylight.models._base import ParametricLight
from skylight.sphere import _harmonics as harmonics


class HarmonicLight(ParametricLight):
    """Radiance over the whole sphere as (degree + 1)^2 coefficients per colour.

    Parameters ``(..., 3 k)`` are coefficients ``(..., k, 3)`` flattened, in the order of
    :mod:`skylight.sphere._harmonics`. ``forward`` is clamped at zero, as light must be;
    ``linear_radiance`` is not, and is what a linear least-squares fit works with. It has no prior:
    any coefficients are as likely.
    """

    basis: Tensor

    def __init__(self, degree: int = 2, height: int = 64) -> None:
        super().__init__(3 * (degree + 1) ** 2, height, sphere=True)
        self.degree = degree
        self.name = f"sh{(degree + 1) ** 2}"
        self.parameter_names = f"{(degree + 1) ** 2} coefficients, RGB of each"
        basis = harmonics.evaluate(self.grid.directions, degree)
        self.register_buffer("basis", basis, persistent=False)

    def linear_radiance(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch n 3"]:
        """``sum_k Y_k(w) c_k``, negative where it rings."""
        self.check_parameters(params)
        params = single(params)
        with full_precision(params):  # terms of either sign are cut at zero
            return self.basis.to(params.dtype) @ params.unflatten(-1, (-1, 3))

    def forward(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch n 3"]:
        """``max(0, sum_k Y_k(w) c_k)``: radiance ``(..., n, 3)`` of coefficients ``(..., 3 k)``.

        Linear Rec.709, in the coefficients' units, in the order of ``grid.directions``.
        """
        return self.linear_radiance(params).clamp(min=0)

    def on_rows(self, height: int) -> "HarmonicLight":
        """The model on ``height`` rows."""
        return HarmonicLight(self.degree, height).to(self.basis)

    def starts(self) -> Float[Tensor, "s p"]:
        """Light of mean luminance 1 above: from everywhere, and from above only."""
        return self._lobes(torch.tensor([[0.0, 1.0, 0.0]]), (0.0, 0.5))[0]

    def starts_towards(self, directions: Float[Tensor, "d 3"]) -> Float[Tensor, "d k p"]:
        """A weak and a strong cosine lobe on top of constant light."""
        return self._lobes(directions, (0.3, 0.7))

    def _lobes(
        self, directions: Float[Tensor, "d 3"], shares: tuple[float, float]
    ) -> Float[Tensor, "d k p"]:
        """Grey ``1 - share + share * 4 <s, w>+``, cut at the model's degree; mean 1 each."""
        basis = self.basis.double()
        share = basis.new_tensor(shares)[:, None]
        direction = harmonics.evaluate(directions.to(basis), self.degree)
        # 4 <s, w>+ has a mean of 1 over the sphere
        lobe = 4 * harmonics.convolve_zonal(direction.T, harmonics.cosine_coefficients(self.degree))
        constant = torch.zeros_like(lobe)
        constant[0] = math.sqrt(4 * math.pi)
        grey = (1 - share) * constant.T[:, None] + share * lobe.T[:, None]
        upper = self.grid.solid_angles * (self.grid.directions[:, 1] > 0) / (2 * math.pi)
        grey = grey / (grey @ basis.T @ upper.to(basis))[..., None]
        return grey.repeat_interleave(3, dim=-1).to(torch.get_default_dtype())


def solve_linear(
    shading_basis: Float[Tensor, "m k"],
    pixels: Float[Tensor, "m 3"],
    weights: Float[Tensor, " m"],
    *,
    ridge: float | Float[Tensor, " k"] = 1e-6,
) -> Float[Tensor, "k 3"]:
    """Coefficients whose shading fits pixels best: weighted least squares with a small ridge.

    ``argmin_c sum_m w_m |B_m c - p_m|^2 + ridge s^2 |c|^2``, where s^2 is the mean squared norm
    of the columns of sqrt(w) B; one ridge for all coefficients or one for each. It decides where
    the pixels do not (a face shows few normals) and changes well-determined coefficients by about
    ``ridge`` of their value.
    """
    root = weights.clamp(min=0).sqrt()[:, None]
    matrix = root * shading_basis
    count = matrix.shape[1]
    scale = matrix.norm() / math.sqrt(count)
    ridges = torch.as_tensor(ridge, dtype=matrix.dtype, device=matrix.device).expand(count)
    damping = scale * torch.diag(ridges.sqrt())
    right = torch.cat([root * pixels, pixels.new_zeros(count, 3)])
    # by singular values: the default driver's last bits differ from call to call (CUDA has one)
    driver = "gels" if matrix.is_cuda else "gelsd"
    return torch.linalg.lstsq(torch.cat([matrix, damping]), right, driver=driver).solution
