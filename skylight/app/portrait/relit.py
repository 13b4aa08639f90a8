"""A photographed person in another light."""

import os
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray

from skylight.app.estimate.types import PhotoEstimate
from skylight.app.portrait.lights import NewLight
from skylight.imaging.colour import linear_to_srgb
from skylight.inverse.portrait.photograph import FaceReflection, light_in_photo, portrait_of
from skylight.inverse.portrait.relit import Keep, Portrait
from skylight.inverse.result import Estimate
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
