"""Random numbers of a batch of scenes, from one generator."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

Range = tuple[float | int, float | int]
Colour = tuple[float, float, float]
MOST_ALBEDO = 0.9  # about that of fresh snow


@dataclass(frozen=True, kw_only=True)
class Draws:
    """Draws for ``count`` scenes, which are the first axis of all that is drawn."""

    count: int
    generator: torch.Generator

    def uniform(self, between: Range, *shape: int) -> Float[Tensor, "b *s"]:
        low, high = between
        return low + (high - low) * torch.rand(self.count, *shape, generator=self.generator)

    def scale(self, between: Range, *shape: int) -> Float[Tensor, "b *s"]:
        """Positive numbers whose logarithm is uniform."""
        low, high = between
        return torch.exp(self.uniform((math.log(low), math.log(high)), *shape))

    def normal(self, *shape: int) -> Float[Tensor, "b *s"]:
        return torch.randn(self.count, *shape, generator=self.generator)

    def chance(self, share: float, *shape: int) -> Bool[Tensor, "b *s"]:
        return self.uniform((0.0, 1.0), *shape) < share

    def some(self, count: int) -> Bool[Tensor, "b n"]:
        """Which of ``count`` things are there: in each scene another share, up to all."""
        return self.uniform((0.0, 1.0), count) < self.uniform((0.3, 1.2), 1)

    def choice(self, weights: list[float], *shape: int) -> Int[Tensor, "b *s"]:
        """Indices with probabilities proportional to ``weights``."""
        edges = torch.tensor(weights).cumsum(0)
        return torch.bucketize(self.uniform((0.0, float(edges[-1])), *shape), edges[:-1])

    def azimuth(self, *shape: int) -> Float[Tensor, "b *s"]:
        return self.uniform((-math.pi, math.pi), *shape)

    def colour(
        self, table: tuple[Colour, ...], *shape: int, spread: float = 0.2
    ) -> Float[Tensor, "b *s 3"]:
        """An albedo of the table, lighter or darker by ``spread`` (of the logarithm)."""
        which = self.choice([1.0] * len(table), *shape)
        lighter = torch.exp(spread * self.normal(*shape))
        return (torch.tensor(table)[which] * lighter[..., None]).clamp(max=MOST_ALBEDO)
