"""A picture in any form in, its light out."""

from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import UInt8

from skylight.errors import InputError
from skylight.imaging.colour import Decode
from skylight.imaging.photo import Photo, photo_from_codes, read_photo
from skylight.inverse.photo import PhotoEstimate, Progress, estimate_photo
from skylight.inverse.solve import Estimate
from skylight.models.shipped import LightName

Device = Literal["cpu", "cuda"]
Image = str | Path | Photo | UInt8[np.ndarray, "h w 3"]


def estimate(
    image: Image,
    *,
    light: LightName = "autoencoder",
    face: int = 1,
    decode: Decode | None = None,
    device: Device = "cpu",
    progress: Progress | None = None,
) -> Estimate:
    """The light in which a face was photographed.

    Parameters
    ----------
    image
        A picture's path, its 8-bit codes (h, w, 3), or a :class:`~skylight.imaging.photo.Photo`.
    light
        The light model: "autoencoder" (learnt skies), "sunsky" (Preetham's sky and a sun), "sh9"
        or "sh25" (spherical harmonics up to degree 2 or 4).
    face
        Which face, counted from 1, the largest.
    decode
        How values encode light: "srgb", "linear" or the exponent of a power law; None for what
        the file says. Not for a ``Photo``, which is decoded already.
    progress
        Called with the name of a stage and the share of it that is done.

    Returns
    -------
    Estimate
        ``environment`` is the light as a 64 x 128 map in the camera's frame: its centre is where
        the camera looks (-Z), +X is the picture's right, +Y up.

    Raises
    ------
    InputError
        The picture cannot be used; the message says why and what to do.
    """
    photo, source = as_photo(image, decode)
    return estimate_with_steps(
        photo, source, light=light, face=face, device=device, progress=progress
    ).estimate


def estimate_with_steps(
    photo: Photo,
    source: str,
    *,
    light: LightName,
    face: int,
    device: Device,
    progress: Progress | None,
) -> PhotoEstimate:
    """:func:`estimate` with everything on the way; ``source`` names the picture in errors."""
    check_device(device)
    return estimate_photo(photo, light=light, face=face, source=source, progress=progress)


def as_photo(image: Image, decode: Decode | None) -> tuple[Photo, str]:
    """(photo, what errors call it)."""
    if isinstance(image, str | Path):
        return read_photo(image, decode=decode), str(image)
    if isinstance(image, np.ndarray):
        return photo_from_codes(image, decode=decode), "the picture"
    if decode is not None:
        raise InputError("decode is for files and 8-bit codes: a Photo is decoded already")
    return image, "the picture"


def check_device(device: Device) -> None:
    """:class:`InputError` where an estimate cannot run there."""
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError(
            "there is no CUDA device that torch can use here; leave --device out to run on the CPU"
        )
    if device != "cpu":
        raise InputError("the optimisation runs on the CPU so far; leave --device out")
