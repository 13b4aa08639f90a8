"""A photographed person in another light."""

import os
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray
from torch import Tensor

from skylight.app.estimate.types import PhotoEstimate
from skylight.app.portrait.lights import NewLight, light_in_photo
from skylight.faces.fit import FaceFit
from skylight.faces.model import HeadModel
from skylight.faces.observe import hair_of
from skylight.faces.segmentation.person import person_matte
from skylight.imaging.colour import linear_to_srgb
from skylight.imaging.photo import Photo
from skylight.inverse.portrait.relit import Keep, Portrait
from skylight.inverse.portrait.surface import BUST, FACE_PX, PersonSurface
from skylight.inverse.result import Estimate
from skylight.sphere.envmap import EnvironmentMap
from skylight.work.progress import Progress

KNEE = 0.8  # of white: brighter than this (or than it was) a picture approaches white softly


@dataclass(frozen=True, kw_only=True)
class RelitPortrait:
    """``picture`` is linear and in the photograph's units, of its size.

    It shows the new light times ``exposure``; ``warning`` says why not to trust it (empty where
    nothing does), and ``notes`` what else there is to know.
    """

    picture: Float[ndarray, "h w 3"]
    photo: Float[ndarray, "h w 3"]
    exposure: float
    warning: str
    notes: tuple[str, ...]


def relit_portrait(
    result: PhotoEstimate,
    light: NewLight,
    *,
    exposure: float = 1.0,
    keep: Keep = "nothing",
    workers: int | None = None,
    progress: Progress | None = None,
) -> RelitPortrait:
    """The (first) face of an estimate and who it belongs to, in another light times ``exposure``.

    ``keep`` is that of :meth:`~skylight.inverse.portrait.relit.Portrait.under`; ``workers`` are the
    processes that trace light, one per core where None.
    """
    portrait = taken_apart(result, workers=workers or os.cpu_count() or 1, progress=progress)
    picture, used = portrait.under(light.environment, exposure, keep=keep)
    return RelitPortrait(
        picture=picture,
        photo=portrait.photo,
        exposure=used,
        warning=warning_of(result.estimate),
        notes=light.notes,
    )


def warning_of(estimate: Estimate) -> str:
    """Why not to trust a portrait that was lit by it; empty where nothing is against it."""
    verdict = estimate.posterior.verdict
    doubtful = verdict.startswith(("unreliable", "doubtful"))
    return f"the light that was found is {verdict}" if doubtful else ""


def taken_apart(
    result: PhotoEstimate, *, workers: int = 1, progress: Progress | None = None
) -> Portrait:
    """The (first) face's photograph as a :class:`~skylight.inverse.portrait.relit.Portrait`."""
    return portrait_of(
        result.photos[result.seen[0].photo],
        result.fit,
        FaceReflection.of(result.estimate),
        light_in_photo(result.estimate),
        workers=workers,
        progress=progress,
    )


@dataclass(frozen=True, kw_only=True)
class FaceReflection:
    """What an estimate tells of a face beside its light: ``gloss`` and ``turns`` of
    :class:`~skylight.inverse.result.FaceLight`."""

    gloss: float
    turns: Float[Tensor, " j"] | None

    @staticmethod
    def of(estimate: Estimate) -> "FaceReflection":
        """The (first) face's."""
        face = estimate.faces[0]
        return FaceReflection(gloss=face.gloss, turns=face.turns)


def portrait_of(
    photo: Photo,
    fit: FaceFit,
    reflection: FaceReflection,
    found: EnvironmentMap,
    *,
    face_px: int = FACE_PX,
    workers: int = 1,
    progress: Progress | None = None,
) -> Portrait:
    """A photograph of a fitted head under the light ``found``, in its colours and units.

    Shading is computed where the face is ``face_px`` high at most.
    """
    person = PersonSurface.of(
        fit, reflection.turns, face_px=face_px, workers=workers, progress=progress
    )
    hair = hair_of(photo.pixels, HeadModel.load(), fit)
    regions = person.region_image()
    small = cv2.resize(hair, regions.shape[::-1], interpolation=cv2.INTER_AREA)
    matte = person_matte(
        photo.encoded,
        (regions >= 0) & (regions != BUST),
        regions == BUST,
        small,
        person.face_px,
    )
    return Portrait.of(photo.pixels, person, found, reflection.gloss, hair, matte, grey=photo.grey)


def shown(relit: RelitPortrait) -> UInt8[ndarray, "h w 3"]:
    """The picture as sRGB codes, its highlights rolled off.

    What became brighter than k, the larger of :data:`KNEE` and the photograph's own value, is
    shown as ``k + (1 - k) tanh((x - k) / (1 - k))``.
    """
    knee = np.maximum(relit.photo, KNEE).clip(max=1 - 1e-6)
    over = np.maximum(relit.picture - knee, 0) / (1 - knee)
    rolled = np.minimum(relit.picture, knee) + (1 - knee) * np.tanh(over)
    codes = linear_to_srgb(torch.from_numpy(rolled).clamp(0, 1)) * 255
    return codes.round().to(torch.uint8).numpy()
