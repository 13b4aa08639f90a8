"""Filters turned to where they are active: the atoms of a code."""

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.csc.correlation import complex_coefficients, real_coefficients
from skylight.sphere import harmonics
from skylight.sphere.rotation import wigner_small


def rotated_filters(
    filters: Float[Tensor, "s k"],
    alpha: Float[Tensor, " s"],
    beta: Float[Tensor, " s"],
    gamma: Float[Tensor, " s"],
) -> Float[Tensor, "s k"]:
    """Coefficients of ``R_j d_j``, each filter with its own rotation (thesis, Eq. 6.9).

    ``f'_m = e^(-i m alpha) sum_n d^l_mn(beta) e^(-i n gamma) f_n``. Differentiable in filters
    and angles, which share one dtype.
    """
    degree = harmonics.degree_of(filters.shape[1])
    spectrum = complex_coefficients(filters)  # (s, l, m >= 0)
    m = torch.arange(degree + 1, dtype=alpha.dtype, device=alpha.device)
    twisted = spectrum * torch.polar(torch.ones_like(gamma)[:, None], -gamma[:, None] * m)[:, None]
    turn = torch.polar(torch.ones_like(alpha)[:, None], -alpha[:, None] * m)
    parts = []
    for l, d in enumerate(wigner_small(beta, degree)):  # noqa: E741
        band = twisted[:, l, : l + 1]
        both = torch.cat([band[:, 1:].conj().flip(1), band], 1)  # n = -l .. l
        moved = torch.einsum("smn,sn->sm", d[:, l:].to(both), both) * turn[:, : l + 1]
        parts.append(torch.nn.functional.pad(moved, (0, degree - l)))
    return real_coefficients(torch.stack(parts, 1))
