"""A person taken apart for a page that moves the sun: shading and transport, without the light.

The page adds, at each of the m points of the person's surface, to the shading S_0 and gloss g_0
by all light but the sun's ::

    S = S_0 + E / pi V(d) <n, d>+,     g = g_0 + gloss E V(d) <n, d>+ f_s(n, d, v),

for a sun of irradiance E at d, and goes on as :mod:`skylight.inverse.portrait.relit` does. V(d) is
interpolated between the four nearest of 32 x 64 directions, so shadows have penumbras of 5.6
degrees.
"""

import json
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor
from torch.nn.functional import normalize

from skylight.app.portrait.relit import KNEE
from skylight.faces.fit import FaceFit
from skylight.faces.observe import SKIN_GLOSS
from skylight.imaging.colour import linear_to_srgb
from skylight.imaging.photo import Photo
from skylight.inverse.portrait.photograph import portrait_of
from skylight.inverse.portrait.relit import (
    BASE,
    BRIGHTEST,
    DARK,
    HAIR_COUNTS,
    SOFT,
    Portrait,
    coarse_power,
)
from skylight.inverse.portrait.surface import scaled
from skylight.io.tensors import write_tensors
from skylight.sphere.envmap import luminance
from skylight.sphere.frame import angles_from_direction
from skylight.studio.tasks.person import KeptPerson, kept_person
from skylight.studio.tasks.uploads import open_photo
from skylight.work.progress import StageProgress

FILE = "portrait.safetensors"
PIXELS = 1280 * 720  # of the picture
FACE_PX = 96  # height of the face where shading is computed
_MAP_ROWS = 64  # of the rest of the light, to be looked at
_MARGIN = 24  # of the part of the shading that is sent, in its pixels: as far as it is blurred


def take_apart(
    path: str, name: str, pixels: int, estimate: str, folder: str, *, tell: StageProgress
) -> dict[str, Any]:
    """Write :data:`FILE`, of the estimate in the folder ``estimate``; nothing to tell."""
    tell("reading the picture", 0.0)
    person = kept_person(Path(estimate))
    photo, fit = _smaller(open_photo(Path(path), name, pixels), person.fit)
    tell("tracing light", 0.0)
    portrait = portrait_of(
        photo,
        fit,
        person.reflection,
        person.found,
        face_px=FACE_PX,
        workers=os.cpu_count() or 1,
        progress=lambda share: tell("tracing light", share),
    )
    tell("writing the results", 0.0)
    tensors, facts = packed(portrait, person)
    write_tensors(Path(folder) / FILE, tensors, {"facts": json.dumps(facts)})
    return {}


def packed(portrait: Portrait, person: KeptPerson) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors and numbers for the page, in the photograph's units.

    ``picture`` (h,w,4) has the photograph's sRGB codes, cut off at white, and its matte. ``crop``
    (left, top, width, height) is the part of the shading's picture, ``size`` (width, height), that
    holds person and surface; ``places`` (m,) are the points' in it. ``visible`` (m,256) has a bit
    for each of 32 x 64 directions, the lowest first. ``found_power`` and ``rest_power`` are
    :func:`~skylight.inverse.portrait.relit.coarse_power`; ``rest_map`` is to be looked at.
    """
    surface, sun = portrait.person.surface, person.sun
    rest_shading, rest_glossy = portrait.shaded_by(sun.rest)
    rows, columns = np.nonzero(portrait.covered)  # row by row, as the surface has them
    left, top, width, height = _crop(portrait)
    codes = (linear_to_srgb(torch.from_numpy(portrait.photo).clamp(0, 1)) * 255).round()
    matte = torch.from_numpy(portrait.matte * 255).round()
    irradiance = sun.irradiance
    if portrait.grey:
        irradiance = luminance(irradiance).expand(3)
    azimuth, zenith = angles_from_direction(sun.direction)
    of_points = {
        "shading": portrait.shading,
        "glossy": portrait.glossy,
        "local": portrait.local,
        "rest_shading": rest_shading,
        "rest_glossy": rest_glossy,
        "inside": portrait.inside,
        "bare": portrait.bare,
    }
    tensors = {
        "picture": torch.cat([codes, matte[..., None]], 2).to(torch.uint8),
        "places": torch.from_numpy((rows - top) * width + columns - left).int(),
        "normals": portrait.person.normals.float(),
        "views": -normalize(surface.positions, dim=1).float(),
        "visible": _bits(portrait.person.sight.visible),
        "found_power": coarse_power(portrait.found).float(),
        "rest_power": coarse_power(sun.rest).float(),
        "rest_map": sun.rest.resize(min(_MAP_ROWS, sun.rest.layout[0])).radiance,
    }
    tensors |= {
        name: torch.from_numpy(image[rows, columns]).float() for name, image in of_points.items()
    }
    facts = person.facts | {
        "size": portrait.covered.shape[::-1],
        "crop": [left, top, width, height],
        "sun": {"azimuth_deg": math.degrees(azimuth), "zenith_deg": math.degrees(zenith)},
        "irradiance": irradiance.tolist(),
        "map_rows": sun.rest.layout[0],
        "gloss": portrait.gloss,
        "lobe": {"f0": SKIN_GLOSS.f0, "alpha": SKIN_GLOSS.alpha},
        "soft_px": SOFT * portrait.person.face_px,
        "dark": DARK,
        "base": BASE,
        "brightest": BRIGHTEST,
        "hair_counts": HAIR_COUNTS,
        "knee": KNEE,
    }
    return tensors, facts


def _bits(visible: Tensor) -> UInt8[Tensor, "m b"]:
    return torch.from_numpy(np.packbits(visible.numpy(), axis=1, bitorder="little"))


def _crop(portrait: Portrait) -> tuple[int, int, int, int]:
    """(left, top, width, height) of what holds surface and matte, with a margin."""
    shown = cv2.resize(portrait.matte, portrait.covered.shape[::-1], interpolation=cv2.INTER_AREA)
    inside = (shown > 0) | (portrait.covered > 0)
    ends: list[tuple[int, int]] = []
    for axis in (0, 1):
        (along,) = np.nonzero(inside.any(axis))
        first = max(0, int(along[0]) - _MARGIN)
        ends.append((first, min(inside.shape[1 - axis], int(along[-1]) + 1 + _MARGIN) - first))
    (left, width), (top, height) = ends
    return left, top, width, height


def _smaller(photo: Photo, fit: FaceFit) -> tuple[Photo, FaceFit]:
    """With :data:`PIXELS` at most."""
    height, width = photo.encoded.shape[:2]
    scale = math.sqrt(PIXELS / (height * width))
    if scale >= 1:
        return photo, fit
    camera = scaled(fit.camera, scale)

    def resized(picture: Any) -> Any:
        return cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)

    small = replace(
        photo,
        pixels=torch.from_numpy(resized(photo.pixels.numpy())),
        encoded=resized(photo.encoded),
        clipped=torch.from_numpy(resized(photo.clipped.numpy().astype(np.float32)) > 0),
    )
    return small, replace(fit, camera=camera)
