"""The background of a photograph: what its camera sees of the light beside the people."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight.transport._matrix import TransportMatrix


@dataclass(frozen=True, kw_only=True)
class Background:
    """Radiance in k blocks of a photograph's view, people cut out.

    ``radiance`` (k,3) is the mean of a block's linear pixels, in the photograph's units, and
    ``averages`` (k,n), rows of sum 1, takes the mean of a map over the directions of the same
    pixels: of light that is infinitely far away, ``radiance = averages @ map`` times the
    photograph's exposure and white balance. ``clipped`` (k,) tells where ``radiance`` is a lower
    bound, because some of the block is over-exposed. ``contrast`` is the standard deviation of the
    log luminance of all its pixels: what is even may be a backdrop, of any brightness and colour.
    ``outdoors``: it shows plants or a sky, by day.
    """

    radiance: Float[Tensor, "k 3"]
    averages: TransportMatrix
    clipped: Bool[Tensor, " k"]
    contrast: float
    outdoors: bool = False

    def __post_init__(self) -> None:
        count = len(self.radiance)
        if count == 0 or len(self.averages.matrix) != count or len(self.clipped) != count:
            raise ValueError(
                f"a background needs as many rows of averages ({len(self.averages.matrix)}) and "
                f"of clipped ({len(self.clipped)}) as blocks ({count}), and at least one"
            )

    def to(self, device: torch.device) -> "Background":
        """The same on a device; the grid of directions stays on the CPU."""
        return replace(
            self,
            radiance=self.radiance.to(device),
            averages=replace(self.averages, matrix=self.averages.matrix.to(device)),
            clipped=self.clipped.to(device),
        )

    def scaled(self, factor: float) -> "Background":
        """The same in a photograph whose pixels are multiplied."""
        return replace(self, radiance=self.radiance * factor)

    def on_rows(self, rows: int) -> "Background":
        """The same for light on a lat-long grid of fewer rows."""
        return replace(self, averages=self.averages.on_rows(rows))
