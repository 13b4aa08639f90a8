"""``EnvironmentMap``: radiance on the sphere; rotate, resize, crop and integrate."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight._modes import constant
from skylight.errors import InputError
from skylight.sphere._frame import (
    DirectionGrid,
    angle_between,
    pixel_from_direction,
    row_edges_cos,
    zenith_span,
)
from skylight.sphere._map_rotation import turned

# ITU-R BT.709-6, section 3.3: luminance of linear RGB.
LUMINANCE = (0.2126, 0.7152, 0.0722)
SUN_REGION_RAD = math.radians(13.0)  # thesis, 5.5.1: the sun's neighbourhood


def luminance(rgb: Float[Tensor, "*s 3"]) -> Float[Tensor, "*s"]:
    """Rec.709 relative luminance."""
    return rgb @ _weights(rgb.dtype, rgb.device)


@constant()
def _weights(dtype: torch.dtype, device: torch.device) -> Float[Tensor, "3"]:
    return torch.tensor(LUMINANCE, dtype=dtype, device=device)


@dataclass(frozen=True, kw_only=True)
class EnvironmentMap:
    """``radiance`` (h,w,3), linear Rec.709: a full lat-long map (w = 2h) or a sky (w = 4h).

    Operations return new maps. Values are not checked here (differentiable code makes maps
    too); files are, when they are read.
    """

    radiance: Float[Tensor, "h w 3"]

    def __post_init__(self) -> None:
        if self.radiance.ndim != 3 or self.radiance.shape[2] != 3:
            raise ValueError(f"radiance must be (h, w, 3), got {tuple(self.radiance.shape)}")
        zenith_span(*self.layout)

    @property
    def layout(self) -> tuple[int, int]:
        return self.radiance.shape[0], self.radiance.shape[1]

    @property
    def is_sky(self) -> bool:
        """True for an upper-hemisphere map."""
        return self.layout[1] == 4 * self.layout[0]

    @property
    def grid(self) -> DirectionGrid:
        return DirectionGrid.latlong(*self.layout)

    @property
    def flat(self) -> Float[Tensor, "n 3"]:
        """Radiance in the order of ``grid.directions``."""
        return self.radiance.reshape(-1, 3)

    def integrate(self) -> Float[Tensor, "3"]:
        """Integral of radiance over solid angle, sum_w L(w) dw."""
        return self._weighted_sum(self.grid.solid_angles)

    def irradiance(self, normal: Float[Tensor, "3"]) -> Float[Tensor, "3"]:
        """sum_w L(w) <n, w>+ dw, unoccluded."""
        grid = self.grid
        weight = (grid.directions @ normal.to(torch.float64)).clamp(min=0) * grid.solid_angles
        return self._weighted_sum(weight)

    def _weighted_sum(self, weight: Float[Tensor, " n"]) -> Float[Tensor, "3"]:
        # float64: in float32 the sum over a map of 1024x2048 is wrong by 0.3 %
        return (weight.to(self.flat.device) @ self.flat.double()).to(self.flat.dtype)

    def mean_direction(self, *, upper_only: bool = True) -> Float[Tensor, "3"]:
        """Unit vector along sum_w Y(w) w dw, over the upper half unless told otherwise."""
        grid = self.grid
        weight = luminance(self.flat).to(torch.float64) * grid.solid_angles
        if upper_only:
            weight = weight * (grid.directions[:, 1] > 0)
        total = weight @ grid.directions
        return total / total.norm().clamp(min=1e-300)

    def brightest_direction(self, *, below: bool = False) -> Float[Tensor, "3"]:
        """Where the light is brightest in the upper half: the sun, where there is one.

        With ``below``, a lamp's, in the whole sphere.

        Centroid of the luminance within 4 degrees of the brightest pixel, weighted by what
        exceeds the median of that pixel's 13-degree neighbourhood: better than a pixel for a
        sun that straddles two or more of them.
        """
        grid = self.grid
        value = luminance(self.flat).to(torch.float64)
        upper = (grid.directions[:, 1] > 0) | below
        peak = grid.directions[torch.where(upper, value, -math.inf).argmax()]
        angle = angle_between(grid.directions, peak.expand_as(grid.directions))
        background = value[(angle < SUN_REGION_RAD) & upper].median()
        near = (angle < math.radians(4.0)) & upper
        excess = (value - background).clamp(min=0) * grid.solid_angles * near
        centroid = excess @ grid.directions
        return peak if centroid.norm() == 0 else centroid / centroid.norm()

    def rotate_azimuth(self, angle_rad: float | Float[Tensor, ""]) -> "EnvironmentMap":
        """Move everything by ``angle_rad`` of azimuth (to the right in the image)."""
        angle = torch.as_tensor(angle_rad, dtype=self.radiance.dtype, device=self.radiance.device)
        return EnvironmentMap(radiance=shift_columns(self.radiance[None], angle[None])[0])

    def rotate(self, rotation: Float[Tensor, "3 3"], *, samples: int = 4) -> "EnvironmentMap":
        """The map turned by a rotation matrix: L'(w) = L(R^T w).

        Each new pixel averages ``samples**2`` bilinear look-ups across its area, with columns
        wrapped and rows continued across the poles, so there is no seam, of a map whose rows are
        averaged to be no finer along themselves than pixels are high. Non-negative and linear.

        Not exact in energy: 0.01 % for smooth maps, up to 2 % for a single bright pixel, 5 % in
        the row next to a pole's and 13 % in the pole's (bounded by a test); less for what covers
        several pixels. Use :meth:`rotate_azimuth` where the turn is about the vertical, which is
        exact.
        """
        if self.is_sky:
            raise ValueError("only a full lat-long map can be turned about any axis")
        return EnvironmentMap(radiance=turned(self.radiance, rotation, samples))

    def with_light(
        self, direction: Float[Tensor, "3"], irradiance: Float[Tensor, "3"]
    ) -> "EnvironmentMap":
        """A full map and a distant light that gives a plane which faces it ``irradiance``.

        L += E share / dw in up to four pixels round its unit ``direction``, with the shares of
        bilinear interpolation, so that the irradiance is kept and the centroid is where the light
        stands, but for one that is above the horizon by less than half a row, which stays above it.
        """
        if self.is_sky:
            raise ValueError("a sky has no pixels below the horizon: give it a ground first")
        height, width = self.layout
        row, column = pixel_from_direction(direction[None], height, width)
        if direction[1] > 0:
            row = row.clamp(max=height // 2 - 1)
        index, share = bilinear_taps(height, width, row, column)
        weight = share[0] / self.grid.solid_angles[index[0]]
        flat = self.flat.clone()
        flat.index_add_(0, index[0], (weight[:, None] * irradiance).to(flat))
        return EnvironmentMap(radiance=flat.reshape(height, width, 3))

    def resize(self, height: int) -> "EnvironmentMap":
        """Average radiance over each new pixel's solid angle: energy is kept exactly."""
        return EnvironmentMap(radiance=averaged(self.radiance, height))

    def upper(self) -> "EnvironmentMap":
        """The sky half of a full map."""
        if self.is_sky:
            return self
        height = self.layout[0]
        if height % 2:
            raise InputError(
                f"the horizon of a map of {height} rows lies within a row: make their number even, "
                f"as by skylight convert IN OUT --height {height - 1}"
            )
        return EnvironmentMap(radiance=self.radiance[: height // 2])

    def with_ground(self, ground: Float[Tensor, "3"]) -> "EnvironmentMap":
        """A full map from a sky and one radiance for all directions below the horizon."""
        sky = self.upper().radiance
        return EnvironmentMap(radiance=torch.cat([sky, ground.to(sky).expand_as(sky)]))


def shift_columns(
    images: Float[Tensor, "*batch h w c"], azimuth_rad: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch h w c"]:
    """Turn lat-long images about the vertical by a continuous angle, circularly.

    Linear interpolation between neighbouring columns: non-negative, exact in energy row by
    row, and differentiable in images and angle (the derivative jumps at whole columns).
    """
    width = images.shape[-2]
    shift = azimuth_rad * (width / (2 * math.pi))
    whole = torch.floor(shift.detach())
    part = (shift - whole)[..., None, None, None]
    index = (torch.arange(width, device=images.device) - whole[..., None].long()) % width
    index = index[..., None, :, None].expand_as(images)
    moved = torch.gather(images, -2, index)
    return (1 - part) * moved + part * torch.roll(moved, 1, dims=-2)


def averaged(images: Float[Tensor, "*batch h w c"], height: int) -> Float[Tensor, "*batch k l c"]:
    """Lat-long images at ``height`` rows: means over each new pixel's solid angle."""
    layout = images.shape[-3], images.shape[-2]
    width = height * layout[1] // layout[0]
    rows = _overlap(row_edges_cos(*layout).flip(0), row_edges_cos(height, width).flip(0))
    rows = rows.flip(0, 1)
    unit = torch.float64
    columns = _overlap(
        torch.linspace(0, 1, layout[1] + 1, dtype=unit),
        torch.linspace(0, 1, width + 1, dtype=unit),
    )
    # float64 sums: a sun is 1e5 times brighter than what it is averaged with
    wide = torch.einsum("ih,...hwc->...iwc", rows.to(images.device), images.double())
    out = torch.einsum("jw,...iwc->...ijc", columns.to(images.device), wide)
    return out.to(images.dtype)


def _overlap(source: Float[Tensor, " m"], target: Float[Tensor, " n"]) -> Float[Tensor, "k l"]:
    """Row-stochastic weights that average cells with borders ``source`` over ``target``'s."""
    low = torch.maximum(source[None, :-1], target[:-1, None])
    high = torch.minimum(source[None, 1:], target[1:, None])
    return (high - low).clamp(min=0) / torch.diff(target)[:, None]


def bilinear(
    image: Float[Tensor, "h w c"], row: Float[Tensor, " n"], column: Float[Tensor, " n"]
) -> Float[Tensor, "n c"]:
    """Bilinear look-up in a full lat-long image, continued across poles and sides."""
    index, weights = bilinear_taps(image.shape[0], image.shape[1], row, column)
    return (image.flatten(0, 1)[index] * weights.to(image)[..., None]).sum(1)


def bilinear_taps(
    height: int, width: int, row: Float[Tensor, " n"], column: Float[Tensor, " n"]
) -> tuple[Int[Tensor, "n 4"], Float[Tensor, "n 4"]]:
    """(pixels of a full lat-long image, row by row, and what each counts) of places between them.

    One row beyond each pole is that pole's own row, half a turn away.
    """
    first_row, first_column = torch.floor(row), torch.floor(column)
    down, right = row - first_row, column - first_column
    index, weights = [], []
    for below in (0, 1):
        r = first_row.long() + below
        turned = torch.where((r < 0) | (r >= height), width // 2, 0)
        for beside in (0, 1):
            c = (first_column.long() + beside + turned) % width
            index.append(r.clamp(0, height - 1) * width + c)
            weights.append((1 - below - down).abs() * (1 - beside - right).abs())
    return torch.stack(index, 1), torch.stack(weights, 1)
