"""Norms of atoms as sampled by a coarse map, which depend on the row and the twist."""

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.csc.correlation.wigner import RotationCorrelation, real_coefficients
from skylight.sphere.latlong_transform import LatLongTransform


def atom_norms(
    correlation: RotationCorrelation, transform: LatLongTransform
) -> list[Float[Tensor, "_ _ rows 1"]]:
    """``sqrt(sum_w dw |(R d)(w)|^2)`` over a map's pixels, per group of the correlation.

    Filters have unit norm over the sphere. Sampled on 32 rows, those of degree 40 have norms from
    0.99 to 1.09, according to how their centres lie between the pixels'. The columns of positions
    and map must be the same, so that the longitude does not matter.
    """
    positions = correlation.positions
    _, width = transform.grid.layout or (0, 0)
    if width != positions.columns:
        raise ValueError(f"maps of {width} columns and positions of {positions.columns} differ")
    m = torch.arange(correlation.degree + 1, dtype=torch.float64)
    # the longitude of column 0
    phase = torch.polar(torch.ones_like(m), -float(positions.alpha[0]) * m)
    phase = phase.to(correlation.phase.device, correlation.phase.dtype)
    norms = []
    for spectra in correlation.spectra():
        rows = []
        for row in spectra:  # (t, f, l, m) of one row
            maps = transform.synthesise(real_coefficients(row * phase))
            weighted = maps.square() * transform.solid_angles.to(maps)
            rows.append(weighted.sum((-2, -1)).sqrt())
        norms.append(torch.stack(rows, -1)[..., None])
    return norms
