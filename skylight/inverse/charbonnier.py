"""The robust loss of inverse lighting."""

import torch
from jaxtyping import Float
from torch import Tensor

CHARBONNIER_EPSILON = 1e-6


def charbonnier(x: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """``sqrt(x^2 + 1e-6)``: smooth, convex, close to ``|x|``."""
    return torch.sqrt(x * x + CHARBONNIER_EPSILON)
