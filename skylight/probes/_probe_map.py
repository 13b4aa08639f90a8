"""Lat-long maps of radiance that tell which part of each pixel is saturated and which was seen."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight.errors import InputError
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid

_ROWS_MIN, _FINEST_ROWS = 16, 1024


@dataclass(frozen=True, kw_only=True)
class ProbeMap:
    """A lat-long map, and what share of each pixel is ``clipped`` and was ``seen``.

    Unseen pixels hold the nearest seen direction.
    """

    environment: EnvironmentMap
    clipped: Float[Tensor, "h w"]
    seen: Float[Tensor, "h w"]

    @property
    def unseen_share(self) -> float:
        """Share of the sphere that no picture showed."""
        weight = self.environment.grid.solid_angles
        return float((1 - self.seen.flatten().double()) @ weight / weight.sum())


def latlong_directions(height: int) -> Float[Tensor, "h w 3"]:
    """Directions of a lat-long map's pixels, float64."""
    return DirectionGrid.latlong(height).directions.reshape(height, 2 * height, 3)


def check_rows(height: int) -> None:
    """:class:`InputError` for rows that no probe has."""
    if not _ROWS_MIN <= height <= _FINEST_ROWS:
        raise InputError(f"--height must be {_ROWS_MIN} to {_FINEST_ROWS} rows, got {height}")


def finer_rows(height: int, px_per_radian: float) -> int:
    """Rows, a multiple of ``height``, that hold what is seen so sharply; 1024 or so at most."""
    wanted = math.ceil(math.pi * px_per_radian / height)
    return height * max(1, min(wanted, _FINEST_ROWS // height))


def averaged(
    light: Float[np.ndarray, "h w 3"],
    clipped: Float[np.ndarray, "h w"],
    seen: Bool[np.ndarray, "h w"],
    height: int,
) -> ProbeMap:
    """The map of ``height`` rows, energy kept, of the values of a finer one."""
    radiance = torch.from_numpy(light.astype(np.float32))
    shares = torch.from_numpy(np.dstack([clipped, seen, seen]).astype(np.float32))
    shares = EnvironmentMap(radiance=shares).resize(height).radiance
    return ProbeMap(
        environment=EnvironmentMap(radiance=radiance).resize(height),
        clipped=shares[..., 0],
        seen=shares[..., 1],
    )
