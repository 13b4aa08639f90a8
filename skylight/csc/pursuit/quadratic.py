"""Squared errors as quadratic forms of spherical harmonic coefficients.

Coding a map and recovering light from shading are one problem: with c the coordinates of the
coded signal and A the linear map from c to what was observed, ::

    |x - A c|^2_W = x^T W x - 2 b^T c + c^T H c,    b = A^T W x,    H = A^T W A,

so a pursuit needs b, the product with H, and no more.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.sphere.latlong_transform import LatLongTransform


@runtime_checkable
class Quadratic(Protocol):
    """``energy - 2 b^T c + c^T H c`` per colour; ``target`` is b."""

    @property
    def target(self) -> Float[Tensor, "k c"]: ...

    @property
    def energy(self) -> Float[Tensor, " c"]: ...

    def hessian(self, coefficients: Float[Tensor, "k *c"]) -> Float[Tensor, "k *c"]:
        """H c."""
        ...


@dataclass(frozen=True, kw_only=True)
class SampledSignal:
    """The error of a lat-long map: A = (B, 1), W = the pixels' solid angles.

    Coordinates are spherical harmonic coefficients, B their basis at the pixels, and, where
    ``pixels``, the pixels' own values after them.
    """

    transform: LatLongTransform
    pixels: bool
    target: Float[Tensor, "k c"]
    energy: Float[Tensor, " c"]

    @staticmethod
    def of(
        maps: Float[Tensor, "h w c"], transform: LatLongTransform, *, pixels: bool = False
    ) -> "SampledSignal":
        planes = maps.movedim(-1, 0)
        return SampledSignal(
            transform=transform,
            pixels=pixels,
            target=_adjoint(planes, transform, pixels=pixels).movedim(-1, 0),
            energy=(planes.square() * transform.solid_angles.to(planes)).sum((1, 2)),
        )

    def hessian(self, coefficients: Float[Tensor, "k *c"]) -> Float[Tensor, "k *c"]:
        rows = coefficients.movedim(0, -1)
        size = (self.transform.degree + 1) ** 2
        maps = self.transform.synthesise(rows[..., :size])
        if self.pixels:
            maps = maps + rows[..., size:].reshape(maps.shape)
        return _adjoint(maps, self.transform, pixels=self.pixels).movedim(-1, 0)


def _adjoint(
    maps: Float[Tensor, "*c h w"], transform: LatLongTransform, *, pixels: bool
) -> Float[Tensor, "*c k"]:
    """A^T W x."""
    coefficients = transform.analyse(maps)
    if not pixels:
        return coefficients
    return torch.cat([coefficients, (maps * transform.solid_angles.to(maps)).flatten(-2)], -1)


@dataclass(frozen=True, kw_only=True)
class LinearObservation:
    """H given as a matrix: light seen through a transport matrix."""

    matrix: Float[Tensor, "k k"]
    target: Float[Tensor, "k c"]
    energy: Float[Tensor, " c"]

    @staticmethod
    def of(
        operator: Float[Tensor, "m k"], values: Float[Tensor, "m c"], weights: Float[Tensor, " m"]
    ) -> "LinearObservation":
        weighted = operator * weights[:, None]
        return LinearObservation(
            matrix=operator.T @ weighted,
            target=weighted.T @ values,
            energy=weights @ values.square(),
        )

    def hessian(self, coefficients: Float[Tensor, "k *c"]) -> Float[Tensor, "k *c"]:
        return torch.einsum("jk,k...->j...", self.matrix.to(coefficients), coefficients)
