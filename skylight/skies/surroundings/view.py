"""The pixels of a sky map, each column in parts, and how much of them something covers."""

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from skylight.skies.surroundings.draws import Draws
from skylight.skies.surroundings.noise import rough_noise

PARTS = 4  # of a column; rows are integrated exactly
TEXTURE_ROWS = 64  # from the horizon to the zenith: a texture's finest detail is 1.4 degrees


@dataclass(frozen=True)
class View:
    """The upper hemisphere seen through ``height`` rows and 4 ``height`` columns of pixels.

    Of the rows only those from the horizon up to number ``rows`` are looked at; 0 is all. All of
    a scene is said as intervals of elevation along the ``c`` = 16 ``height`` parts of
    columns; a pixel's rows are covered as far as intervals reach into them.
    """

    height: int
    rows: int = 0

    def up_to(self, elevation: float) -> "View":
        """The view of the rows that reach down to the horizon from an elevation (rad)."""
        rows = math.ceil(elevation / (math.pi / 2) * self.height)
        return View(self.height, min(max(rows, 1), self.height))

    @property
    def parts(self) -> int:
        return 4 * self.height * PARTS

    @cached_property
    def azimuth(self) -> Float[Tensor, " c"]:
        """Of the middle of each part."""
        return 2 * math.pi * ((torch.arange(self.parts) + 0.5) / self.parts - 0.5)

    @cached_property
    def elevation(self) -> Float[Tensor, "h 1"]:
        """Of the middle of each row that is looked at, the highest first."""
        down = (torch.arange(self.height) + 0.5) / self.height
        return (math.pi / 2 * (1 - down))[-self.rows :, None]

    @cached_property
    def frame(self) -> tuple[Float[Tensor, "c 3"], Float[Tensor, "c 3"]]:
        """(level unit vectors away from the observer, those to the right of them)."""
        sin, cos = torch.sin(self.azimuth), torch.cos(self.azimuth)
        zero = torch.zeros_like(sin)
        return torch.stack([sin, zero, -cos], -1), torch.stack([cos, zero, sin], -1)

    def between(
        self, low: Float[Tensor, "b c"], high: Float[Tensor, "b c"]
    ) -> Float[Tensor, "b h c"]:
        """The share of each row, in elevation, that lies from ``low`` to ``high`` (rad)."""
        step = math.pi / 2 / self.height
        bottom = self.elevation - step / 2
        reach = torch.minimum(high[:, None], bottom + step) - torch.maximum(low[:, None], bottom)
        return reach.clamp(min=0) / step

    def across(
        self, azimuth: Float[Tensor, "b n"], half_rad: Float[Tensor, "b n"]
    ) -> Float[Tensor, "b n c"]:
        """The share of each part that upright strips of a width of 2 ``half_rad`` cover."""
        step = 2 * math.pi / self.parts
        away = torch.remainder(self.azimuth - azimuth[..., None] + math.pi, 2 * math.pi) - math.pi
        half = half_rad[..., None]
        reach = torch.minimum(away + step / 2, half) - torch.maximum(away - step / 2, -half)
        return reach.clamp(min=0) / step

    def texture(self, draws: Draws, roughness: float) -> Float[Tensor, "b h c"]:
        """Rough noise over the hemisphere, drawn on one lattice for maps of all heights.

        A larger map so shows the same scene.
        """
        noise = rough_noise(draws, TEXTURE_ROWS, 4 * TEXTURE_ROWS, roughness)
        return _resized(noise, self.height, self.parts)[:, -self.rows :]

    def profile(self, draws: Draws, roughness: float) -> Float[Tensor, "b c"]:
        """Rough noise along the horizon."""
        noise = rough_noise(draws, 1, 4 * TEXTURE_ROWS, roughness)
        return _resized(noise, 1, self.parts)[:, 0]

    def pixels(self, fine: Float[Tensor, "b h c k"]) -> Float[Tensor, "b h w k"]:
        """The mean of each pixel's parts."""
        return fine.unflatten(2, (-1, PARTS)).mean(3)


def _resized(noise: Float[Tensor, "b r k"], height: int, columns: int) -> Float[Tensor, "b h c"]:
    """Averaged where it shrinks and interpolated where it grows, round the horizon."""
    rim = 4  # columns repeated beyond either end
    padded = torch.cat([noise[..., -rim:], noise, noise[..., :rim]], -1)[:, None]
    beyond = rim * columns // noise.shape[-1]
    size = (height, columns + 2 * beyond)
    wide = functional.interpolate(padded, size, mode="bilinear", antialias=height < noise.shape[1])
    return wide[:, 0, :, beyond : beyond + columns]
