"""Skies as tensors: sun in the centre column, mean luminance 1."""

import math
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.skies.index import SkyRecord, map_path
from skylight.skies.layouts import read_sky
from skylight.sphere.envmap import luminance, shift_columns
from skylight.sphere.grid import DirectionGrid


def centre_column_azimuth(height: int) -> float:
    """Azimuth of the middle of column w/2 of a sky map, where training wants the sun."""
    return math.pi / (4 * height)


def load_skies(
    place: Path, records: list[SkyRecord], *, height: int = 32
) -> Float[Tensor, "n h w 3"]:
    """The maps of ``records``: sun turned to the centre column, mean luminance 1.

    ``height`` x ``4 height`` upper hemispheres, float32, area-averaged from whichever layout
    they were captured in. ``place`` is the index's folder or file. Raises
    :class:`InputError` for a map that is missing, damaged or all black.
    """
    skies = []
    for record in records:
        path = map_path(place, record)
        sky = read_sky(path, record.layout, field_deg=record.field_deg).resize(height)
        if not sky.radiance.any():
            raise InputError(f"{path}: the map is all black; take it out of the index")
        skies.append(sky.radiance)
    azimuth = torch.tensor([math.radians(r.map_azimuth_deg) for r in records])
    return normalise(shift_columns(torch.stack(skies), centre_column_azimuth(height) - azimuth))


def normalise(skies: Float[Tensor, "n h w 3"]) -> Float[Tensor, "n h w 3"]:
    """Scale each sky to a mean luminance of 1 over the hemisphere, the sun included.

    Raises :class:`InputError` for an all-black sky, which has no such scale.
    """
    height, width = skies.shape[1:3]
    solid = DirectionGrid.latlong(height, width).solid_angles.reshape(height, width)
    solid = solid.to(skies.device)
    mean = (luminance(skies).double() * solid).sum((1, 2)) / (2 * math.pi)
    if not (mean > 0).all():
        number = int((mean > 0).long().argmin())
        raise InputError(f"sky {number} of {len(skies)} is all black: it cannot be scaled")
    return skies / mean.to(skies)[:, None, None, None]
