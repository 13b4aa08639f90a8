"""How bright to show linear radiance."""

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.sphere.envmap import luminance


def white_of(values: Float[Tensor, "m 3"]) -> float:
    """The luminance to show as white: a little above nearly all."""
    return max(1.05 * float(torch.quantile(luminance(values.float()), 0.98)), 1e-30)
