"""A picture in any form in, its light out."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import UInt8

from skylight.errors import InputError
from skylight.faces.landmarks import FaceLandmarker, LandmarkerName, default_landmarker
from skylight.faces.mediapipe_face import MediaPipeLandmarker
from skylight.imaging.colour import Decode
from skylight.imaging.photo import Photo, photo_from_codes, read_photo
from skylight.inverse.estimate import Estimate
from skylight.inverse.photo import PhotoEstimate, Progress, estimate_photos
from skylight.models.shipped import LightName

Device = Literal["cpu", "cuda"]
Image = str | Path | Photo | UInt8[np.ndarray, "h w 3"]
Faces = int | Literal["all"]


def estimate(
    image: Image,
    *more: Image,
    light: LightName = "autoencoder",
    face: Faces = 1,
    decode: Decode | None = None,
    device: Device = "cpu",
    landmarks: LandmarkerName = "dlib",
    landmark_model: str | Path | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """The light in which a face was photographed, or several.

    Parameters
    ----------
    image, more
        A picture's path, its 8-bit codes (h, w, 3), or a :class:`~skylight.imaging.photo.Photo`.
        Several pictures share their light: their cameras are taken to look the same way.
    light
        The light model: "autoencoder" (learnt skies), "sunsky" (Preetham's sky and a sun), "sh9"
        or "sh25" (spherical harmonics up to degree 2 or 4).
    face
        Which face of each picture, counted from 1, the largest; or "all", under one light.
    decode
        How values encode light: "srgb", "linear" or the exponent of a power law; None for what
        the file says. Not for a ``Photo``, which is decoded already.
    landmarks, landmark_model
        What finds the face: "dlib", or "mediapipe" with the ``.task`` file of MediaPipe's face
        landmarker, which is free for commercial use.
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
    pictures = [
        as_photo(one, decode, f"picture {number}" if more else "the picture")
        for number, one in enumerate((image, *more), start=1)
    ]
    return estimate_with_steps(
        [photo for photo, _ in pictures],
        [source for _, source in pictures],
        light=light,
        face=face,
        device=device,
        landmarker=choose_landmarker(landmarks, landmark_model),
        progress=progress,
    ).estimate


def estimate_with_steps(
    photos: Sequence[Photo],
    sources: Sequence[str],
    *,
    light: LightName,
    face: Faces,
    device: Device,
    landmarker: FaceLandmarker | None = None,
    progress: Progress | None,
) -> PhotoEstimate:
    """:func:`estimate` with everything on the way; ``sources`` name the pictures in errors."""
    check_device(device)
    return estimate_photos(
        photos,
        light=light,
        faces=face,
        sources=sources,
        landmarker=landmarker,
        workers=os.cpu_count() or 1,
        progress=progress,
    )


def choose_landmarker(name: LandmarkerName, model: str | Path | None) -> FaceLandmarker:
    """What finds faces; :class:`InputError` where ``model`` is missing, or has no use."""
    if name == "mediapipe" and model is not None:
        return MediaPipeLandmarker(model)
    if name == "mediapipe":
        raise InputError(
            "landmarks by mediapipe need its model: download face_landmarker.task (Google's AI "
            "Edge pages, Face Landmarker) and name it with --landmark-model"
        )
    if name != "dlib":
        raise InputError(f"{name!r} is no landmarker; choose dlib or mediapipe")
    if model is not None:
        raise InputError(
            f"{model}: dlib's landmarks bring their own model; add --landmarks mediapipe, or "
            "leave --landmark-model out"
        )
    return default_landmarker()


def as_photo(image: Image, decode: Decode | None, name: str = "the picture") -> tuple[Photo, str]:
    """(photo, what errors call it): ``name`` where it is no file."""
    if isinstance(image, str | Path):
        return read_photo(image, decode=decode), str(image)
    if isinstance(image, np.ndarray):
        return photo_from_codes(image, decode=decode), name
    if decode is not None:
        raise InputError("decode is for files and 8-bit codes: a Photo is decoded already")
    return image, name


def check_device(device: Device) -> None:
    """:class:`InputError` where an estimate cannot run there."""
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError(
            "there is no CUDA device that torch can use here; leave --device out to run on the CPU"
        )
    if device != "cpu":
        raise InputError("the optimisation runs on the CPU so far; leave --device out")
