"""Quadrature on the sphere: directions and their solid angles."""

import math
from dataclasses import dataclass
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.sphere.frame import direction_from_angles, zenith_span


@dataclass(frozen=True, kw_only=True)
class DirectionGrid:
    """Directions (n,3), float64, unit; solid angles (n,) in sr; lat-long ``layout`` or None.

    Row ``i`` of a lat-long layout has the exact solid angle
    ``dphi (cos t_i - cos t_{i+1})`` per pixel, so every row, and not only the sum, is right.
    """

    directions: Float[Tensor, "n 3"]
    solid_angles: Float[Tensor, " n"]
    layout: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if self.directions.shape != (self.solid_angles.shape[0], 3):
            raise ValueError(
                f"directions {tuple(self.directions.shape)} and solid_angles "
                f"{tuple(self.solid_angles.shape)} do not match: expected (n, 3) and (n,)"
            )
        if self.layout is not None and math.prod(self.layout) != len(self):
            raise ValueError(f"layout {self.layout} does not hold {len(self)} directions")

    def __len__(self) -> int:
        return self.solid_angles.shape[0]

    @property
    def is_sphere(self) -> bool:
        """Whether the layout is that of the whole sphere, not of the upper hemisphere."""
        return self.layout is not None and self.layout[1] == 2 * self.layout[0]

    @staticmethod
    def latlong(height: int, width: int | None = None) -> "DirectionGrid":
        """Pixel centres of a lat-long image: (h, 2h) the sphere (default), (h, 4h) the sky."""
        return _latlong(height, 2 * height if width is None else width)

    @staticmethod
    def sky(height: int) -> "DirectionGrid":
        """The upper hemisphere, ``height`` rows by ``4 * height`` columns."""
        return _latlong(height, 4 * height)

    @staticmethod
    def hammersley(count: int) -> "DirectionGrid":
        """``count`` low-discrepancy directions of equal solid angle 4 pi / count.

        Point i: cos(zenith) = 1 - (2 i + 1) / n, azimuth = 2 pi phi_2(i), the base-2 radical
        inverse (Wong, Luk, Heng 1997).
        """
        index = torch.arange(count, dtype=torch.float64)
        radical, scale, rest = torch.zeros_like(index), 0.5, index.clone()
        for _ in range(max(1, count.bit_length())):
            radical += scale * (rest % 2)
            rest, scale = torch.floor(rest / 2), scale / 2
        zenith = torch.acos(1 - (2 * index + 1) / count)
        return DirectionGrid(
            directions=direction_from_angles(2 * math.pi * radical, zenith),
            solid_angles=torch.full((count,), 4 * math.pi / count, dtype=torch.float64),
        )


def row_edges_cos(height: int, width: int) -> Float[Tensor, " edges"]:
    """cos(zenith) at the height + 1 row borders of a lat-long layout, float64, descending."""
    span = zenith_span(height, width)
    return torch.cos(torch.linspace(0, span, height + 1, dtype=torch.float64))


@cache
def _latlong(height: int, width: int) -> DirectionGrid:
    span = zenith_span(height, width)
    zenith = (torch.arange(height, dtype=torch.float64) + 0.5) * span / height
    azimuth = ((torch.arange(width, dtype=torch.float64) + 0.5) / width - 0.5) * 2 * math.pi
    zenith, azimuth = torch.meshgrid(zenith, azimuth, indexing="ij")
    row = -torch.diff(row_edges_cos(height, width)) * 2 * math.pi / width
    return DirectionGrid(
        directions=direction_from_angles(azimuth, zenith).reshape(-1, 3),
        solid_angles=row.repeat_interleave(width),
        layout=(height, width),
    )
