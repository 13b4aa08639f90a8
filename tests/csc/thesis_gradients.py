"""The thesis' three ways to ``<R d_i, r>``, minus the gradient of half the squared loss (Eq. 6.6).

They compute what :class:`skylight.csc._wigner.RotationCorrelation` computes, at every
direction and twist of :class:`~skylight.csc._positions.Positions`, to be compared with
it by benchmarks and tests:

=============================  ================  =====================================
:class:`IsotropicGradient`     6.4.3             isotropic filters: products per band
:class:`RotatedResiduals`      6.4.4, "simpler"  the residual turned N T times
:class:`RotatedZonalGradient`  6.4.5, "RZH"      the residual as lobes with turned axes
=============================  ================  =====================================

Each takes filters (f, k) about the zenith and positions, and maps a residual (k,) to
(f, rows, columns, twists). Below, k = (K + 1)^2, f = filters, N = rows columns, T = twists.
"""

import math
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor, nn

from skylight.csc._positions import Positions
from skylight.csc._wigner import ZonalCorrelation
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._rotation import matrix_from_euler, rotation_blocks

_DRAWS = 16
_TWISTED_BYTES = 2**25  # of twisted residuals at a time: more is no faster, less much slower
_LOOKUP_BYTES = 2**25  # of look-ups at a time: measured fastest


class IsotropicGradient(ZonalCorrelation):
    """``B diag(Pi d_i) r`` (Eq. 6.7, 6.8, C.2), the same for every twist.

    O(f rows K (K + columns)) products: the transform is separable in rows and columns.
    """

    def forward(self, residual: Float[Tensor, " k"]) -> Float[Tensor, "f rows columns t"]:
        (values,) = self.by_group(residual)
        return values[0, ..., None].repeat(1, 1, 1, self.positions.twists)


class RotatedResiduals(nn.Module):
    """``d_i^T R^T r``: the residual turned to the filters for each of N T rotations (Eq. 6.9-6.11).

    ``R^T = Rz(-gamma) Ry(-beta) Rz(-alpha)``, from ``columns + rows + twists`` basic rotations:
    64 + 32 + 32 in the thesis. Those about the pole are sparse, those by elevation a dense block
    for each band. Products: 4/3 N K^3 for the elevations, 2 N T k for the twists, and f N T k with
    the filters, which is nearly all.
    """

    def __init__(
        self,
        filters: Float[Tensor, "f k"],
        positions: Positions,
        *,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        self.positions, self.dtype = positions, dtype
        self.degree = harmonics.degree_of(filters.shape[1])
        self.azimuths = _PolarTurns(-positions.alpha, self.degree, dtype)
        self.products = _TwistedProducts(filters, positions, dtype)
        zero = torch.zeros_like(positions.beta)
        tilts = matrix_from_euler(zero, positions.beta, zero)
        for l, block in enumerate(rotation_blocks(tilts, self.degree)):  # noqa: E741
            self.register_buffer(f"elevation_{l}", block.to(dtype), persistent=False)

    def forward(self, residual: Float[Tensor, " k"]) -> Float[Tensor, "f rows columns t"]:
        turned = self.azimuths(residual.to(self.dtype)[None])[0]  # (columns, k)
        tilted = turned.new_empty(self.positions.rows, *turned.shape)
        for l in range(self.degree + 1):  # noqa: E741
            band = slice(l * l, (l + 1) ** 2)
            # row vectors: r^T D is D^T r, the turn by -beta
            tilted[..., band] = turned[:, band] @ self.get_buffer(f"elevation_{l}")
        return self.products(tilted.flatten(0, 1))


class RotatedZonalGradient(nn.Module):
    """``sum_kj r_kj d_ki(R^T w_j)``: the residual as rotated zonal lobes (Eq. 6.12, 6.13, C.3-C.5).

    ``r_k = A_k r`` with ``A_k`` the inverse of the band's harmonics at the axes w_j, whose first
    2k + 1 serve band k. The look-ups ``d_ki = B (Pi e_k * d_i)`` are evaluated exactly, not
    interpolated: the harmonics at the turned axes times the filters' coefficients. Swapping the
    sums, the filters come in once, by a matrix product::

        sum_km d_i,km q_km(R),    q_km(R) = sum_j r_kj Y_km(R^T w_j)

    where Pi (C.2) has cancelled the factor of C.5. As the twist is the last turn of the axes, q
    needs harmonics for N places only, and their twists are turns about the pole.

    N (2 K + 1) k harmonics, as many products with r_kj, then 2 N T k for the twists and f N T k
    with the filters. Harmonics and lobes are in double precision: the lobes nearly cancel, by as
    many digits as ``A_k`` has condition (1e3 to 1e4 at K = 40).
    """

    axes: Tensor

    def __init__(
        self,
        filters: Float[Tensor, "f k"],
        positions: Positions,
        *,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        self.positions, self.dtype = positions, dtype
        self.degree = harmonics.degree_of(filters.shape[1])
        self.products = _TwistedProducts(filters, positions, dtype)
        self.register_buffer("axes", sampling_directions(self.degree), persistent=False)
        for l, sampled in enumerate(sampled_bands(self.axes, self.degree)):  # noqa: E741
            self.register_buffer(f"lobes_{l}", torch.linalg.inv(sampled), persistent=False)
        beta, alpha = torch.meshgrid(positions.beta, positions.alpha, indexing="ij")
        rotations = matrix_from_euler(alpha, beta, torch.zeros_like(alpha)).flatten(0, 1)
        self.register_buffer("rotations", rotations, persistent=False)

    def forward(self, residual: Float[Tensor, " k"]) -> Float[Tensor, "f rows columns t"]:
        residual = residual.to(self.axes)
        lobes = [
            self.get_buffer(f"lobes_{l}") @ residual[l * l : (l + 1) ** 2]
            for l in range(self.degree + 1)  # noqa: E741
        ]
        rotations = self.get_buffer("rotations")
        each = 8 * len(self.axes) * len(residual)
        placed = [
            self._placed(chunk, lobes).to(self.dtype)
            for chunk in rotations.split(max(1, _LOOKUP_BYTES // each))
        ]
        return self.products(torch.cat(placed))

    def _placed(
        self, rotations: Float[Tensor, "n 3 3"], lobes: list[Float[Tensor, " _"]]
    ) -> Float[Tensor, "n k"]:
        """q without twist."""
        directions = self.axes @ rotations  # rows: R^T w_j
        basis = harmonics.evaluate(directions.flatten(0, 1), self.degree)
        basis = basis.unflatten(0, directions.shape[:2])
        bands = [
            torch.einsum("njm,j->nm", basis[:, : len(lobe), l * l : (l + 1) ** 2], lobe)
            for l, lobe in enumerate(lobes)  # noqa: E741
        ]
        return torch.cat(bands, 1)


class _PolarTurns(nn.Module):
    """Expansions turned about the pole by a set of angles: two numbers a row, all bands at once.

    As :func:`skylight.sphere._rotation.turn_about_pole`, with the cosines and sines made once.
    """

    cosine: Tensor
    sine: Tensor
    mirrored: Tensor

    def __init__(self, angles_rad: Float[Tensor, " a"], degree: int, dtype: torch.dtype) -> None:
        super().__init__()
        m = harmonics.orders(degree)
        angle = angles_rad[:, None] * m
        self.register_buffer("cosine", torch.cos(angle).to(dtype), persistent=False)
        self.register_buffer("sine", torch.sin(angle).to(dtype), persistent=False)
        self.register_buffer("mirrored", torch.arange(len(m)) - 2 * m, persistent=False)

    def forward(self, coefficients: Float[Tensor, "n k"]) -> Float[Tensor, "n a k"]:
        turned = coefficients[:, None] * self.cosine
        return turned.addcmul_(coefficients[:, None, self.mirrored], self.sine, value=-1)


class _TwistedProducts(nn.Module):
    """Residuals turned to N places -> each twisted T times -> inner products with all filters."""

    filters: Tensor

    def __init__(
        self, filters: Float[Tensor, "f k"], positions: Positions, dtype: torch.dtype
    ) -> None:
        super().__init__()
        self.positions = positions
        self.twists = _PolarTurns(-positions.gamma, harmonics.degree_of(filters.shape[1]), dtype)
        self.register_buffer("filters", filters.to(dtype), persistent=False)

    def forward(self, placed: Float[Tensor, "n k"]) -> Float[Tensor, "f rows columns t"]:
        p = self.positions
        out = placed.new_empty(len(self.filters), len(p))
        at_once = max(1, _TWISTED_BYTES // (p.twists * placed[0].nbytes))
        for start in range(0, len(placed), at_once):
            twisted = self.twists(placed[start : start + at_once]).flatten(0, 1)
            here = slice(start * p.twists, start * p.twists + len(twisted))
            torch.mm(self.filters, twisted.T, out=out[:, here])
        return out.view(-1, p.rows, p.columns, p.twists)


@cache
def sampling_directions(degree: int) -> Float[Tensor, "n 3"]:
    """2 degree + 1 random directions whose first 2l + 1 determine band l, for every l.

    The best of 16 draws by the largest condition number of a band's ``Y_l(w_j)``; about 1e3 to
    1e4 at degree 40, so that inverting the samples costs as many digits.
    """
    generator = torch.Generator().manual_seed(0)
    best, lowest = torch.empty(0), math.inf
    for _ in range(_DRAWS):
        draw = torch.randn(2 * degree + 1, 3, dtype=torch.float64, generator=generator)
        draw = draw / draw.norm(dim=1, keepdim=True)
        worst = max(float(torch.linalg.cond(s)) for s in sampled_bands(draw, degree))
        if worst < lowest:
            best, lowest = draw, worst
    return best


def sampled_bands(directions: Float[Tensor, "n 3"], degree: int) -> list[Float[Tensor, "i j"]]:
    """``Y_lm(w_j)``, rows m, columns the first 2l + 1 directions: Eq. C.5 without its factor.

    The thesis' factor sqrt(4 pi / (2l + 1)) cancels in Eq. C.3.
    """
    basis = harmonics.evaluate(directions, degree)
    return [basis[: 2 * l + 1, l * l : (l + 1) ** 2].T for l in range(degree + 1)]  # noqa: E741
