"""Spherical harmonic transforms of lat-long maps, separable in rows and columns."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight._modes import on_cpu
from skylight._module import Module
from skylight.errors import check_shape
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._frame import DirectionGrid


class LatLongTransform(Module):
    """Real spherical harmonic transform of maps of (h, 2h) pixels, and its adjoint.

    Coefficients are those of ``harmonics.evaluate_about_zenith``. With B (n, k) that basis at the
    pixels' centres and W their solid angles, ``synthesise`` is B c and ``analyse``, which a call of
    the module is, B^T W x: each other's adjoints, and ``analyse(synthesise(c))`` is the Gram matrix
    of the sampled basis, which tends to 1 with many rows. Neither forms B: as
    ``Y_lm = Q_lm(row) cos(m phi)`` or ``sin(m phi)``, a map costs h K (K + w) products. Both keep
    leading dimensions, dtype and device.
    """

    legendre: Tensor
    cosines: Tensor
    sines: Tensor
    solid_angles: Tensor
    order: Tensor

    @on_cpu
    def __init__(self, degree: int, height: int) -> None:
        super().__init__()
        self.degree = degree
        self.grid = DirectionGrid.latlong(height)
        width = 2 * height
        column = self.grid.directions.reshape(height, width, 3)[:, 0]
        basis = harmonics.evaluate_about_zenith(_at_longitude_zero(column), degree)
        m, l = torch.meshgrid(torch.arange(degree + 1), torch.arange(degree + 1), indexing="ij")  # noqa: E741
        inside = (l >= m).double()
        index = (l * (l + 1) + m).clamp(max=(degree + 1) ** 2 - 1)
        legendre = basis[:, index] * inside  # (h, m, l): cosines are 1 at longitude 0
        longitude = _longitudes(width)
        angle = torch.arange(degree + 1, dtype=torch.float64)[:, None] * longitude
        self.register_buffer("legendre", legendre.movedim(0, 1).contiguous(), persistent=False)
        self.register_buffer("cosines", torch.cos(angle), persistent=False)
        self.register_buffer("sines", torch.sin(angle), persistent=False)
        row = self.grid.solid_angles.reshape(height, width)[:, :1]
        self.register_buffer("solid_angles", row, persistent=False)
        # place of c_lm and s_lm; where l < m the factor is 0, any place does
        order = torch.stack([index, (l * (l + 1) - m).clamp(min=0)])
        self.register_buffer("order", order, persistent=False)

    def forward(self, maps: Float[Tensor, "*c h w"]) -> Float[Tensor, "*c k"]:
        """``sum_w x(w) Y_lm(w) dw``: :meth:`analyse`, (degree + 1)^2 coefficients of each map."""
        return self.analyse(maps)

    def synthesise(self, coefficients: Float[Tensor, "*c k"]) -> Float[Tensor, "*c h w"]:
        """``sum_lm c_lm Y_lm`` at the pixels' centres."""
        check_shape("LatLongTransform's coefficients", coefficients.shape, (self.degree + 1) ** 2)
        legendre = self.legendre.to(coefficients.dtype)
        cosine, sine = coefficients[..., self.order].unbind(-3)  # (*c, m, l)
        cosine = torch.einsum("mhl,...ml->...hm", legendre, cosine)
        sine = torch.einsum("mhl,...ml->...hm", legendre, sine)
        return cosine @ self.cosines.to(legendre.dtype) + sine @ self.sines.to(legendre.dtype)

    def analyse(self, maps: Float[Tensor, "*c h w"]) -> Float[Tensor, "*c k"]:
        """``sum_w x(w) Y_lm(w) dw`` over the pixels."""
        layout = len(self.solid_angles), self.cosines.shape[1]
        check_shape("LatLongTransform's maps", maps.shape, *layout)
        legendre = self.legendre.to(maps.dtype)
        weighted = maps * self.solid_angles.to(maps.dtype)
        cosine = torch.einsum(
            "mhl,...hm->...ml", legendre, weighted @ self.cosines.to(maps.dtype).T
        )
        sine = torch.einsum("mhl,...hm->...ml", legendre, weighted @ self.sines.to(maps.dtype).T)
        return self._ordered(cosine, sine)

    def basis_at(self, rows: Int[Tensor, " s"], columns: Int[Tensor, " s"]) -> Float[Tensor, "s k"]:
        """Y_lm at the centres of single pixels: rows of B."""
        legendre = self.legendre[:, rows].movedim(1, 0)  # (s, m, l)
        cosine = legendre * self.cosines[:, columns].T[..., None]
        return self._ordered(cosine, legendre * self.sines[:, columns].T[..., None])

    def _ordered(
        self, cosine: Float[Tensor, "*c m l"], sine: Float[Tensor, "*c m l"]
    ) -> Float[Tensor, "*c k"]:
        """One row of coefficients from those of cos(m phi) and of sin(m phi)."""
        out = cosine.new_empty(*cosine.shape[:-2], (self.degree + 1) ** 2)
        m, l = torch.triu_indices(self.degree + 1, self.degree + 1, device=cosine.device)  # noqa: E741
        # m = 0 has no sine: the cosine, written last, takes its place
        out[..., l * (l + 1) - m] = sine[..., m, l]
        out[..., l * (l + 1) + m] = cosine[..., m, l]
        return out


def _at_longitude_zero(directions: Float[Tensor, "h 3"]) -> Float[Tensor, "h 3"]:
    """The same heights on the meridian of +Z, where every sine vanishes."""
    y = directions[:, 1]
    return torch.stack([torch.zeros_like(y), y, torch.hypot(directions[:, 0], directions[:, 2])], 1)


def _longitudes(width: int) -> Float[Tensor, " w"]:
    """About the zenith, from +Z towards +X, of a lat-long map's columns: pi minus the azimuth."""
    azimuth = ((torch.arange(width, dtype=torch.float64) + 0.5) / width - 0.5) * 2 * math.pi
    return math.pi - azimuth
