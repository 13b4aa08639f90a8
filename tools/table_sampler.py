"""Importance sampling of an environment map from tables: rows, then columns."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.csc._coder import pixel_of
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import row_edges_cos


@dataclass(frozen=True, kw_only=True)
class TableSampler:
    """Inversion of the cumulative luminance of rows, (h,), and in each row of columns, (h,w).

    As pbrt and Mitsuba do it for piecewise constant maps (Pharr, Jakob, Humphreys 2023, 12.5),
    float32; within a pixel directions are uniform, so that ``pdf``, which is read off the map, is
    constant there.
    """

    rows: Float[Tensor, " h"]
    columns: Float[Tensor, "h w"]
    density: Float[Tensor, " n"]

    @staticmethod
    def of(environment: EnvironmentMap) -> "TableSampler":
        height, width = environment.layout
        power = luminance(environment.flat.double()) * environment.grid.solid_angles
        columns = power.view(height, width).cumsum(1)
        rows = columns[:, -1].cumsum(0)
        shares = columns / columns[:, -1:].clamp(min=1e-300)
        return TableSampler(
            rows=(rows / rows[-1]).float(),
            columns=shares.float(),
            density=(luminance(environment.flat.double()) / rows[-1]).float(),
        )

    @property
    def numbers(self) -> int:
        """Of the two tables alone."""
        return self.rows.numel() + self.columns.numel()

    def sample(
        self, count: int, generator: torch.Generator | None = None
    ) -> Float[Tensor, "count 3"]:
        """``count`` independent unit directions of density :meth:`pdf`."""
        height, width = self.columns.shape
        choice = torch.rand(4, count, generator=generator)
        row = torch.searchsorted(self.rows, choice[0], right=True).clamp(max=height - 1)
        # all rows in one ascending table: row i holds i .. i + 1
        table = (self.columns.double() + torch.arange(height)[:, None]).flatten()
        place = torch.searchsorted(table, row + choice[1].double(), right=True)
        column = (place - row * width).clamp(0, width - 1)
        edges = row_edges_cos(height, width).float()
        y = torch.lerp(edges[row], edges[row + 1], choice[2])
        azimuth = 2 * torch.pi * ((column + choice[3]) / width - 0.5)
        radius = (1 - y * y).sqrt()
        return torch.stack([radius * azimuth.sin(), y, -radius * azimuth.cos()], 1)

    def pdf(self, directions: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """The density in unit directions, per steradian."""
        height, width = self.columns.shape
        return self.density[pixel_of(directions.double(), (height, width))]
