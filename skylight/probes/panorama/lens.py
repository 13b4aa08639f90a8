"""The lens of a turning camera: one focal length, one radial distortion, the middle of the picture.

Places (x, y) in a picture count from its upper left corner, pixel centres at halves; the camera
looks along -Z, +X is the picture's right, +Y its up (:mod:`skylight.cameras.intrinsics` has the
other way to say so).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from skylight.cameras.intrinsics import FLIP, Intrinsics
from skylight.cameras.turns import pinhole_rays


@dataclass(frozen=True, kw_only=True)
class Lens:
    """Pictures of ``width`` x ``height``, ``focal_px`` in their pixels; Brown's ``k1``."""

    width: int
    height: int
    focal_px: float
    k1: float = 0.0

    @property
    def size(self) -> tuple[int, int]:
        return self.width, self.height

    @cached_property
    def intrinsics(self) -> Intrinsics:
        """The same in OpenCV's convention, pixel centres at integers."""
        return Intrinsics(
            width=self.width,
            height=self.height,
            fx=self.focal_px,
            fy=self.focal_px,
            cx=(self.width - 1) / 2,
            cy=(self.height - 1) / 2,
            k1=self.k1,
        )

    @property
    def half_diagonal_rad(self) -> float:
        """From the middle of the picture to its corners."""
        (corner,) = self.rays(np.zeros((1, 2)))
        return float(np.arccos(-corner[2]))

    def rays(self, places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """Unit directions in the camera's frame."""
        straight = self.intrinsics.undistort_points(places - 0.5) + 0.5
        return pinhole_rays(straight, self.focal_px, self.size)

    def project(self, rays: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Where directions in the camera's frame are seen; nonsense for those not :meth:`ahead`."""
        return self.intrinsics.project(rays @ FLIP) + 0.5

    def ahead(self, rays: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Which directions lie before the camera, where distortion does not fold the picture.

        r (1 + k1 r^2) grows up to r^2 = -1 / (3 k1).
        """
        depth = -rays[:, 2]
        r2 = (rays[:, :2] ** 2).sum(1) / np.maximum(depth, 1e-6) ** 2
        return (depth > 0.05) & (1 + 3 * self.k1 * r2 > 0)

    def scaled(self, width: int, height: int) -> "Lens":
        """The same lens for pictures of another size."""
        return replace(
            self, width=width, height=height, focal_px=self.focal_px * width / self.width
        )
