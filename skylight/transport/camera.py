"""A pinhole camera at the world's origin: pixels to rays and points to pixels."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Looks along -Z from the origin; +X is the picture's right, +Y its up.

    ``focal_px`` and ``center_px`` (x, y) are in pixels, x to the right and y down; the centre of
    the pixel in row r and column c is (c + 0.5, r + 0.5). Pixels are square.
    """

    focal_px: float
    width: int
    height: int
    center_px: tuple[float, float]

    def __post_init__(self) -> None:
        if self.focal_px <= 0 or self.width < 1 or self.height < 1:
            raise ValueError(
                f"focal_px, width and height must be positive, got {self.focal_px}, "
                f"{self.width}, {self.height}"
            )

    def rays(self) -> Float[Tensor, "hw 3"]:
        """Unit direction through each pixel's centre, row by row, float64."""
        y, x = torch.meshgrid(
            torch.arange(self.height, dtype=torch.float64) + 0.5,
            torch.arange(self.width, dtype=torch.float64) + 0.5,
            indexing="ij",
        )
        cx, cy = self.center_px
        rays = torch.stack([x - cx, cy - y, torch.full_like(x, -self.focal_px)], dim=-1)
        return torch.nn.functional.normalize(rays.reshape(-1, 3), dim=1)

    def project(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 2"]:
        """Image position (x, y) in px: c + f (X, -Y) / (-Z); points must have Z < 0."""
        x, y, z = points.unbind(1)
        cx, cy = self.center_px
        return torch.stack([cx - self.focal_px * x / z, cy + self.focal_px * y / z], dim=1)
