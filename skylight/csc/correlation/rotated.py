"""Filters after rotations: the atoms of a code."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.csc.correlation.wigner import complex_coefficients, real_coefficients
from skylight.sphere import harmonics
from skylight.sphere.frame import direction_from_angles
from skylight.sphere.rotation import wigner_small


def rotated_filters(
    filters: Float[Tensor, "s k"], rotations: Float[Tensor, "s 3"]
) -> Float[Tensor, "s k"]:
    """Coefficients of ``R_j d_j``, each filter with its own rotation (thesis, Eq. 6.9).

    ``f'_m = e^(-i m alpha) sum_n d^l_mn(beta) e^(-i n gamma) f_n`` with the Euler angles (alpha,
    beta, gamma) of ``rotations``. Differentiable in filters and angles. Wigner's functions are
    evaluated once for each beta that differs: grids have few.
    """
    degree = harmonics.degree_of(filters.shape[1])
    alpha, beta, gamma = rotations.to(filters).unbind(1)
    spectrum = complex_coefficients(filters)  # (s, l, m >= 0)
    m = torch.arange(degree + 1, dtype=alpha.dtype, device=alpha.device)
    twisted = spectrum * torch.polar(torch.ones_like(gamma)[:, None], -gamma[:, None] * m)[:, None]
    turn = torch.polar(torch.ones_like(alpha)[:, None], -alpha[:, None] * m)
    if beta.requires_grad:
        rows, order, counts = beta, torch.arange(len(beta), device=beta.device), [1] * len(beta)
    else:
        rows, row = beta.unique(return_inverse=True)
        order, counts = row.argsort(), torch.bincount(row, minlength=len(rows)).tolist()
    twisted = torch.view_as_real(twisted[order])
    sign = twisted.new_tensor([1.0, -1.0])  # of a conjugate
    parts = []
    for l, d in enumerate(wigner_small(rows, degree)):  # noqa: E741
        band = twisted[:, l, : l + 1]
        both = torch.cat([(band[:, 1:] * sign).flip(1), band], 1)  # n = -l .. l
        groups = zip(d[:, l:].to(both), both.split(counts), strict=True)
        moved = torch.cat([table @ some for table, some in groups]) if counts else both[:, l:]
        parts.append(torch.nn.functional.pad(moved, (0, 0, 0, degree - l)))
    moved = torch.view_as_complex(torch.stack(parts, 1))[order.argsort()]
    return real_coefficients(moved * turn[:, None])


def rotated_zonal_filters(
    filters: Float[Tensor, "s k"], rotations: Float[Tensor, "s 3"]
) -> Float[Tensor, "s k"]:
    """:func:`rotated_filters` of isotropic filters, by the addition theorem."""
    degree = harmonics.degree_of(filters.shape[1])
    alpha, beta, _ = rotations.to(filters).unbind(1)
    basis = harmonics.evaluate_about_zenith(direction_from_angles(math.pi - alpha, beta), degree)
    bands = harmonics.bands(degree).to(filters.device)
    return basis * harmonics.zonal_factors(filters)[:, bands]
