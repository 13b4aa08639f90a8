"""A photographed person in another light, from an estimate to a picture file."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray
from PIL import Image, ImageDraw, ImageFont

from skylight.estimation._kept import KeptFace
from skylight.estimation._summary import PhotoEstimate
from skylight.imaging._colour import tone_map
from skylight.io._files import write_light, write_png
from skylight.portrait._lights import NewLight
from skylight.portrait._relit import Keep, Portrait, light_in_photo, portrait_of
from skylight.work._progress import Progress
from skylight.work._threads import cores

KNEE = 0.8  # of white: brighter than this (or than it was) a picture approaches white softly


@dataclass(frozen=True, kw_only=True)
class RelitPortrait:
    """``picture`` is linear and in the photograph's units, of its size.

    It shows the new light times ``exposure``; ``warning`` says why not to trust it (empty where
    nothing does), and ``notes`` what else there is to know. ``white`` is the value that is shown as
    white: 1 but of photographs in units of their own (.exr, .hdr, RAW).
    """

    picture: Float[ndarray, "h w 3"]
    photo: Float[ndarray, "h w 3"]
    exposure: float
    warning: str
    notes: tuple[str, ...]
    white: float = 1.0


def relit_portrait(
    result: PhotoEstimate | KeptFace,
    light: NewLight,
    *,
    exposure: float = 1.0,
    keep: Keep = "nothing",
    portrait: Portrait | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> RelitPortrait:
    """The (first) face of an estimate and who it belongs to, in another light times ``exposure``.

    An estimate that was written is read again by :func:`~skylight.estimation._kept.read_face`.
    ``keep`` is that of :meth:`~skylight.portrait._relit.Portrait.under`; ``portrait`` what
    :func:`taken_apart` made of the estimate, for several lights; ``workers`` are the processes that
    trace light otherwise, one per core where None.
    """
    face = KeptFace.of(result)
    portrait = portrait or taken_apart(face, workers=workers or cores(), progress=progress)
    picture, used = portrait.under(light.environment, exposure, keep=keep, edge=light.edge)
    return RelitPortrait(
        picture=picture,
        photo=portrait.photo,
        exposure=used,
        warning=face.warning,
        notes=(*light.notes, *portrait.doubts),
        white=portrait.white,
    )


def taken_apart(
    result: PhotoEstimate | KeptFace, *, workers: int = 1, progress: Progress | None = None
) -> Portrait:
    """The (first) face's photograph as a :class:`~skylight.portrait._relit.Portrait`."""
    face = KeptFace.of(result)
    return portrait_of(
        face.photo,
        face.fit,
        face.reflection,
        light_in_photo(face),
        workers=workers,
        progress=progress,
    )


def shown(relit: RelitPortrait) -> UInt8[ndarray, "h w 3"]:
    """The picture as sRGB codes, its highlights rolled off.

    What became brighter than k, the larger of :data:`KNEE` and the photograph's own value, is
    shown as ``k + (1 - k) tanh((x - k) / (1 - k))``.
    """
    picture, photo = relit.picture / relit.white, relit.photo / relit.white
    knee = np.maximum(photo, KNEE).clip(max=1 - 1e-6)
    over = np.maximum(picture - knee, 0) / (1 - knee)
    rolled = np.minimum(picture, knee) + (1 - knee) * np.tanh(over)
    return tone_map(torch.from_numpy(rolled), white=1.0)


def write_relit(path: Path, relit: RelitPortrait) -> None:
    """A .png (8-bit sRGB, with lines below it where there is a warning) or a linear .exr."""
    if path.suffix.lower() == ".png":
        codes = shown(relit)
        write_png(path, np.concatenate([codes, _strip(relit.warning, codes.shape[1])]))
    else:
        write_light(path, torch.from_numpy(relit.picture), header={})


def _strip(text: str, width: int) -> UInt8[ndarray, "h {width} 3"]:
    """The text below a picture of that width, in as many lines as it takes; no rows without any."""
    if not text:
        return np.zeros((0, width, 3), np.uint8)
    size = max(10, min(width // 40, 28))
    font = ImageFont.load_default(size)
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if font.getlength(longer) > width - size and lines[-1]:
            lines.append(word)
        else:
            lines[-1] = longer
    picture = Image.new("RGB", (width, round((1.25 * len(lines) + 0.75) * size)), (40, 40, 40))
    draw, spacing = ImageDraw.Draw(picture), 1.25 * size
    for number, line in enumerate(lines):
        draw.text((size / 2, size / 2 + number * spacing), line, (255, 210, 63), font)
    return np.array(picture)
